"""Radial distortion that remains in the corner residuals after undistortion.

The adjustment has no unknown for distortion. Focal lengths, poses and board scale absorb most of the distortion. The
rest gives the residuals of all views the same radial pattern. The problem is nearly linear at the solution, so linear
least squares on the final residuals gives the coefficient k1 of the radial model x (1 + k1 r^2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.projection import jacobian_of_seen, pixel_jacobian, reprojection_residuals
from calibration.solver.adjustment import Adjustment
from calibration.solver.problem import Problem


@dataclass(frozen=True)
class ResidualDistortion:
    """Remaining radial distortion."""

    k1: float
    """Remaining coefficient k1 of OpenCV's distortion model; 0 if the views do not determine `k1`."""
    sigma: float
    """Standard deviation of `k1`; infinite if the views do not determine `k1`."""


def estimate_residual_distortion(problem: Problem, adjusted: Adjustment) -> ResidualDistortion:
    """Estimate the radial distortion that remains in the corner residuals.

    In each view, the estimate ignores the part of the residuals that a change of board pose, camera matrix or board
    scale could explain. Errors of these parameters are therefore not mistaken for distortion.

    Args:
        problem: The measurements and priors.
        adjusted: The solution with its used views and inlier corners.

    Returns:
        The coefficient k1 with its standard deviation.
    """
    corners = problem.corners
    corrections = adjusted.unknowns.corrections
    inliers = adjusted.inliers & adjusted.used[:, None]
    T_camera_board = adjusted.unknowns.T_camera_board(problem)
    residuals, points = reprojection_residuals(T_camera_board, corrections, corners)
    rays = points[..., :2] / points[..., 2:]
    # Jacobian of the pixels with respect to k1.
    J_k1 = corners.K[[0, 1], [0, 1]] * (1 + corrections[:2]) * rays * (rays**2).sum(axis=2, keepdims=True)
    jacobians = pixel_jacobian(T_camera_board, corrections, corners, points)
    g = 0.0
    H = 0.0
    for view in np.flatnonzero(inliers.any(axis=1)):
        seen = inliers[view]
        J_explained = jacobian_of_seen(jacobians[view], seen)
        unexplained = _project_out(J_explained, J_k1[view, seen].T.ravel())
        g += float(unexplained @ residuals[view, seen].T.ravel())
        H += float(unexplained @ unexplained)
    if not H > 0:
        return ResidualDistortion(0.0, float("inf"))
    return ResidualDistortion(g / H, adjusted.noise.pixel_px / float(np.sqrt(H)))


def _project_out(columns: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the component of `values` (K,) that is orthogonal to the columns of `columns` (K, L)."""
    # The columns can be linearly dependent: in a frontal view, board distance and focal length have the same effect.
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(np.float64).tiny)
    return values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-9)[0]
