"""Estimate the board pose in each image: refine the two IPPE solutions of a planar target and keep the better one."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import pose_from_twist, solve_stack
from calibration.pose_estimation.projection import (
    N_CORRECTIONS,
    Corners,
    PixelNormalEquations,
    pixel_normal_equations,
    reprojection_residuals,
)
from calibration.target.board import MIN_CORNERS

MAX_ITERATIONS = 20
"""Maximum number of Levenberg-Marquardt iterations."""
INITIAL_DAMPING = 1e-4
"""Damping of the first iteration, relative to the diagonal of the information matrix."""
DAMPING_DECREASE = 0.1
"""Factor of the damping after an iteration that decreases the residuals."""
DAMPING_INCREASE = 10
"""Factor of the damping after an iteration that increases the residuals."""
MIN_INFORMATION = 1e-9
"""Information that is added to the diagonal, so that a view without corners gives no step."""
MIN_GAIN_SHARE = 1e-10
"""Decrease of the squared residuals, relative to their sum, below which the iteration stops."""
MIN_GAIN_PX2 = 1e-20
"""Decrease of the squared residuals below which the iteration stops, px^2; for residuals of zero."""
MEDIAN_LENGTH_SIGMAS = 1.177
"""Median length of a normal error in two coordinates, in standard deviations per coordinate."""
MAX_RESIDUAL_SIGMAS = 5.0
"""A corner is an outlier if its residual exceeds this number of standard deviations. By chance, one corner in 300 000
exceeds the limit."""
MAX_AMBIGUITY_RATIO = 3.0
"""Maximum ratio of the reprojection errors of the second and the first IPPE solution. Above this ratio, the second
solution is dropped."""
MIN_NOISE_PX = 1e-3
"""Lower limit of the corner noise, pixels. Smaller residuals are rounding errors."""
PLACEHOLDER_POSE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]])
"""Placeholder (4, 4) for a view without a board pose, so that all views are computed as one stack."""


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """Board poses of N views, each estimated from the corners of one view alone."""

    T_camera_board: NDArray[np.float64]
    """(N, 4, 4) board poses in the camera frame, metres; NaN where no pose was found."""
    inliers: NDArray[np.bool_]
    """(N, M) mask, True for corners that fit the pose of the view."""
    rms_px: NDArray[np.float64]
    """(N,) root mean square reprojection residual of the inliers per image coordinate, pixels; NaN where no pose was
    found."""

    @property
    def found(self) -> NDArray[np.bool_]:
        """(N,) mask, True where a pose was found."""
        return np.isfinite(self.rms_px)


def estimate_board_poses(corners: Corners) -> BoardPoses:
    """Estimate the board pose of each view, with the reported camera matrix and the nominal board size.

    Args:
        corners: The corners of N views.

    Returns:
        The poses. A view has no pose if fewer than six corners, or fewer than half of its corners, are inliers.
    """
    count = len(corners.pixels)
    guesses = np.full((2, count, 4, 4), np.nan)
    for k in range(count):
        seen = corners.seen[k]
        if seen.sum() >= MIN_CORNERS:
            guesses[:, k] = _initial_poses(corners.points[seen], corners.pixels[k, seen], corners.K)
    first = _refine_robustly(guesses[0], corners)
    ambiguous = np.flatnonzero(np.isfinite(guesses[1]).all(axis=(1, 2)))
    if not len(ambiguous):
        return first
    ambiguous_corners = replace(corners, pixels=corners.pixels[ambiguous], seen=corners.seen[ambiguous])
    second = _refine_robustly(guesses[1, ambiguous], ambiguous_corners)
    better = second.found & ~(first.rms_px[ambiguous] <= second.rms_px)
    replaced = ambiguous[better]
    first.T_camera_board[replaced] = second.T_camera_board[better]
    first.inliers[replaced] = second.inliers[better]
    first.rms_px[replaced] = second.rms_px[better]
    return first


def inlier_corners(T: NDArray[np.float64], corrections: NDArray[np.float64], corners: Corners) -> NDArray[np.bool_]:
    """Return the mask of the inlier corners, by a limit from the median residual of each view.

    Args:
        T: (N, 4, 4) board poses in the camera frame.
        corrections: (N_CORRECTIONS,) corrections of the camera matrix and of the board scale.
        corners: The corners of N views.

    Returns:
        (N, M) mask, True for inlier corners.
    """
    distances = np.linalg.norm(reprojection_residuals(T, corrections, corners)[0], axis=2)
    # A view without corners takes the median of its zero residuals, because the median of no residuals is NaN.
    counted = corners.seen | ~corners.seen.any(axis=1, keepdims=True)
    sigma = np.nanmedian(np.where(counted, distances, np.nan), axis=1) / MEDIAN_LENGTH_SIGMAS
    return corners.seen & (distances <= MAX_RESIDUAL_SIGMAS * np.maximum(sigma, MIN_NOISE_PX)[:, None])


def refine_poses(
    T: NDArray[np.float64], corrections: NDArray[np.float64], corners: Corners, inliers: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Refine the board pose of each view by Levenberg-Marquardt, with separate damping for each view.

    Args:
        T: (N, 4, 4) initial board poses in the camera frame.
        corrections: (N_CORRECTIONS,) corrections of the camera matrix and of the board scale.
        corners: The corners of N views.
        inliers: (N, M) mask of the corners to use.

    Returns:
        (N, 4, 4) refined board poses.
    """
    damping = np.full(len(T), INITIAL_DAMPING)
    current = pixel_normal_equations(T, corrections, corners, inliers)
    for _ in range(MAX_ITERATIONS):
        H = current.H[:, :6, :6].copy()
        diagonal = np.einsum("nii->ni", H)
        diagonal += damping[:, None] * diagonal + MIN_INFORMATION
        step = solve_stack(H, current.g[:, :6])
        T_tried = pose_from_twist(step) @ T
        tried = pixel_normal_equations(T_tried, corrections, corners, inliers)
        better = tried.squares_px2 <= current.squares_px2
        damping = np.where(better, damping * DAMPING_DECREASE, damping * DAMPING_INCREASE)
        T = np.where(better[:, None, None], T_tried, T)
        gain = np.where(better, current.squares_px2 - tried.squares_px2, 0.0)
        if (gain <= MIN_GAIN_SHARE * current.squares_px2 + MIN_GAIN_PX2).all():
            break
        current = PixelNormalEquations(
            np.where(better[:, None, None], tried.H, current.H),
            np.where(better[:, None], tried.g, current.g),
            np.where(better, tried.squares_px2, current.squares_px2),
        )
    return T


def _initial_poses(
    points: NDArray[np.float64], pixels: NDArray[np.float64], K: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the IPPE poses (2, 4, 4), the better pose first; NaN for a pose that is missing or clearly worse."""
    import cv2

    guesses = np.full((2, 4, 4), np.nan)
    try:
        _, rotations, translations, errors = cv2.solvePnPGeneric(
            points, pixels[:, None], K, None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return guesses
    # OpenCV returns the better pose first. The second pose is refined only if it is nearly as good.
    is_ambiguous = len(rotations) > 1 and float(errors[1, 0]) < MAX_AMBIGUITY_RATIO * float(errors[0, 0]) + MIN_NOISE_PX
    for k, (rotation, translation) in enumerate(zip(rotations[: 1 + is_ambiguous], translations, strict=False)):
        v = np.concatenate([rotation.ravel(), translation.ravel()]).astype(np.float64)
        if np.isfinite(v).all() and v[5] > 0:
            guesses[k] = pose_from_twist(v)
    return guesses


def _refine_robustly(T: NDArray[np.float64], corners: Corners) -> BoardPoses:
    """Refine the initial poses `T` (N, 4, 4), NaN for none, three times; exclude outlier corners after each time."""
    found = np.asarray(np.isfinite(T).all(axis=(1, 2)))
    T = np.where(found[:, None, None], T, PLACEHOLDER_POSE)
    corrections = np.zeros(N_CORRECTIONS)
    inliers = corners.seen & found[:, None]
    for _ in range(2):
        T = refine_poses(T, corrections, corners, inliers)
        inliers = inlier_corners(T, corrections, corners) & found[:, None]
    T = refine_poses(T, corrections, corners, inliers)
    counts = inliers.sum(axis=1)
    found = found & (counts >= np.maximum(MIN_CORNERS, corners.seen.sum(axis=1) / 2))
    squares_px2 = pixel_normal_equations(T, corrections, corners, inliers).squares_px2
    rms = np.sqrt(squares_px2 / np.maximum(2 * counts, 1))
    return BoardPoses(np.where(found[:, None, None], T, np.nan), inliers, np.where(found, rms, np.nan))
