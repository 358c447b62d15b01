"""Radial distortion that is left in the corners: what a lens does to pictures that were taken for straightened ones.

The adjustment has no unknown for it, and hides most of it in the focal length, the poses and the board's size. What it
cannot hide bends the residuals of every view in the same way. Near the solution everything is linear, so that one
coefficient k1, of x (1 + k1 r^2), is read from the final residuals, without solving anew.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.pose_estimation.projection import pixel_jacobian, reprojection
from calibration.solver.bundle_adjustment import Adjustment
from calibration.solver.problem import Problem


@dataclass(frozen=True)
class ResidualDistortion:
    """The coefficient k1 of OpenCV's model that the views still ask for."""

    k1: float
    sigma: float
    """Its standard deviation; infinite where the views cannot tell."""


def estimate_residual_distortion(problem: Problem, adjusted: Adjustment) -> ResidualDistortion:
    """By the corners that the solution was made of.

    What a view's own board pose, camera matrix and board size can explain is taken off first, view by view: no error in
    them is mistaken for the lens.
    """
    corners, lens = problem.corners, adjusted.unknowns.lens
    good = adjusted.good & adjusted.used[:, None]
    T_camera_board = adjusted.unknowns.T_camera_board(problem)
    residuals, points = reprojection(T_camera_board, lens, corners)
    rays = points[..., :2] / points[..., 2:]
    bent = corners.K[[0, 1], [0, 1]] * (1 + lens[:2]) * rays * (rays**2).sum(axis=2, keepdims=True)
    jacobians = pixel_jacobian(T_camera_board, lens, corners, points)
    pull, information = 0.0, 0.0
    for view in np.flatnonzero(good.any(axis=1)):
        seen = good[view]
        explained = jacobians[view].reshape(-1, 2, len(seen))[:, :, seen].reshape(len(jacobians[view]), -1).T
        by_k1 = _rest(explained, bent[view, seen].T.ravel())
        pull += float(by_k1 @ residuals[view, seen].T.ravel())
        information += float(by_k1 @ by_k1)
    if not information > 0:
        return ResidualDistortion(0.0, float("inf"))
    return ResidualDistortion(pull / information, adjusted.noise.pixel_px / float(np.sqrt(information)))


def _rest(explained: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What of `values` (K,) no combination of the columns `explained` (K, L) is, by least squares."""
    # Of a view from straight ahead, board and focal lengths change alike: columns may depend on one another.
    scaled = explained / np.maximum(np.linalg.norm(explained, axis=0), np.finfo(np.float64).tiny)
    return values - scaled @ np.linalg.lstsq(scaled, values, rcond=1e-9)[0]
