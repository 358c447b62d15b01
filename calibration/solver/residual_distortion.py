"""Radial distortion that remains in the corners of images that were assumed to be undistorted.

The adjustment has no unknown for it. The focal lengths, poses and scale of the board absorb most of it; the rest bends
the residuals of all views in the same way. Near the solution everything is linear, so the coefficient k1 of the radial
model x (1 + k1 r^2) can be read from the final residuals without another adjustment.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.projection import pixel_jacobian, reprojection_residuals
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.problem import Problem


@dataclass(frozen=True)
class ResidualDistortion:
    """Remaining radial distortion."""

    k1: float
    """Coefficient k1 of OpenCV's model that the residuals still contain."""
    sigma: float
    """One sigma of `k1`; infinite if the views cannot determine it."""


def estimate_residual_distortion(problem: Problem, adjusted: Adjustment) -> ResidualDistortion:
    """Estimate the radial distortion that remains in the corners of the solution.

    In each view, the part that its own board pose, camera matrix and board size can explain is removed first. An error
    in these is therefore not mistaken for distortion.
    """
    corners, lens = problem.corners, adjusted.unknowns.lens
    inliers = adjusted.inliers & adjusted.used[:, None]
    T_camera_board = adjusted.unknowns.T_camera_board(problem)
    residuals, points = reprojection_residuals(T_camera_board, lens, corners)
    rays = points[..., :2] / points[..., 2:]
    # Derivative of the pixels with respect to k1.
    J_k1 = corners.K[[0, 1], [0, 1]] * (1 + lens[:2]) * rays * (rays**2).sum(axis=2, keepdims=True)
    jacobians = pixel_jacobian(T_camera_board, lens, corners, points)
    g, H = 0.0, 0.0
    for view in np.flatnonzero(inliers.any(axis=1)):
        seen = inliers[view]
        J_explained = jacobians[view].reshape(-1, 2, len(seen))[:, :, seen].reshape(len(jacobians[view]), -1).T
        unexplained = _project_out(J_explained, J_k1[view, seen].T.ravel())
        g += float(unexplained @ residuals[view, seen].T.ravel())
        H += float(unexplained @ unexplained)
    if not H > 0:
        return ResidualDistortion(0.0, float("inf"))
    return ResidualDistortion(g / H, adjusted.noise.pixel_px / float(np.sqrt(H)))


def _project_out(columns: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the part of `values` (K,) that is orthogonal to all `columns` (K, L)."""
    # Seen from straight ahead, board and focal lengths have the same effect: columns may depend on one another.
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(np.float64).tiny)
    return values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-9)[0]
