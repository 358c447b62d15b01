"""Corner patterns: test whether the corner residuals of all views have a common smooth pattern in the image.

A wrong distortion model or a bent board shifts neighbouring corners alike, in all views. Such shifts also change the
estimated lens, and they do not average out over the corners. The size of the patterns that no lens correction can
explain shows how far the corners can be trusted about the lens.
"""

import numpy as np

from calibration.pose_estimation.projection import jacobian_of_seen, pixel_jacobian, reprojection_residuals
from calibration.solver.adjustment import Adjustment
from calibration.solver.problem import Problem

EXPONENTS = ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""Exponents of the image coordinates x and y in the patterns: the second and third order, as of distortion models."""
MIN_INFORMATION_SHARE = 1e-9
"""Minimum information about a pattern, relative to the best determined one. Other patterns are ignored."""
MIN_DIVISOR = 1e-12
"""Lower limit of norms and eigenvalues, which are zero if the views have no corners."""


def lens_information_weight(problem: Problem, adjusted: Adjustment) -> float:
    """Return the weight of the corners' information about the lens: 1 if the corner noise is independent.

    The weight is the expected square of the patterns, for independent noise, divided by the observed square. The
    patterns are polynomials of the image coordinates. In each view, the part that a change of board pose, camera
    matrix or board scale explains is projected out.

    Args:
        problem: The measurements and priors.
        adjusted: The solution with its used views and inlier corners.
    """
    corners = problem.corners
    corrections = adjusted.unknowns.corrections
    inliers = adjusted.inliers & adjusted.used[:, None]
    T_camera_board = adjusted.unknowns.T_camera_board(problem)
    residuals, points = reprojection_residuals(T_camera_board, corrections, corners)
    jacobians = pixel_jacobian(T_camera_board, corrections, corners, points)
    rays = points[..., :2] / points[..., 2:]
    # Rays of similar size make the polynomials well conditioned.
    rays = rays / max(float(np.abs(rays[inliers]).max(initial=0.0)), 1e-9)
    shifts = np.stack([rays[..., 0] ** m * rays[..., 1] ** n for m, n in EXPONENTS], axis=2)
    count = 2 * len(EXPONENTS)
    g = np.zeros(count)
    H = np.zeros((count, count))
    for view in np.flatnonzero(inliers.any(axis=1)):
        seen = inliers[view]
        patterns = np.kron(np.eye(2), shifts[view, seen])
        explained = jacobian_of_seen(jacobians[view], seen)
        explained = explained / np.maximum(np.linalg.norm(explained, axis=0), MIN_DIVISOR)
        patterns = patterns - explained @ np.linalg.lstsq(explained, patterns, rcond=1e-9)[0]
        g += patterns.T @ residuals[view, seen].T.ravel()
        H += patterns.T @ patterns
    values, vectors = np.linalg.eigh(H)
    determined = values > MIN_INFORMATION_SHARE * max(float(values[-1]), MIN_DIVISOR)
    if not determined.any():
        return 1.0
    squares = (vectors.T @ g)[determined] ** 2 / values[determined] / adjusted.noise.pixel_px**2
    if not squares.sum() > 0:
        return 1.0
    return float(min(1.0, determined.sum() / squares.sum()))
