"""Where the board is in each picture by itself: the two poses a flat board may have, refined, and the better kept."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import pose_from_twist, solve_stack
from calibration.pose_estimation.projection import LENS, Corners, PixelBlocks, pixel_blocks, reprojection
from calibration.target.board import FEWEST_CORNERS

STEPS = 20
CORNER_LIMIT = 5.0
"""A corner so many standard deviations from where the others say it should be is left out; by chance it is one in
300 000."""
RIVAL = 3.0
"""The second pose of a flat board is looked at whose reprojection error is up to so many times the first one's."""
LEAST_NOISE_PX = 1e-3
"""Below this, differences are rounding."""
AHEAD = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]])
"""Stands for a pose that is not known, so that all views can be worked out at once."""


@dataclass(frozen=True, eq=False)
class BoardPoses:
    """One pose for each of N views."""

    T_camera_board: NDArray[np.float64]
    """(N, 4, 4); NaN where there is none."""
    good: NDArray[np.bool_]
    """(N, M) corners that fit the pose."""
    rms_px: NDArray[np.float64]
    """(N,) of the good corners' two coordinates; NaN where there is no pose."""

    @property
    def found(self) -> NDArray[np.bool_]:
        """(N,) where there is a pose."""
        return np.isfinite(self.rms_px)


def estimate_board_poses(corners: Corners) -> BoardPoses:
    """The board's pose in every view with enough corners that fit one, by the camera and board as told."""
    count = len(corners.pixels)
    guesses = np.full((2, count, 4, 4), np.nan)
    for k in range(count):
        if corners.seen[k].sum() >= FEWEST_CORNERS:
            guesses[:, k] = _two_poses(corners.points[corners.seen[k]], corners.pixels[k, corners.seen[k]], corners.K)
    first = _refined(guesses[0], corners)
    rivals = np.flatnonzero(np.isfinite(guesses[1]).all(axis=(1, 2)))
    if not len(rivals):
        return first
    second = _refined(guesses[1, rivals], replace(corners, pixels=corners.pixels[rivals], seen=corners.seen[rivals]))
    better = second.found & ~(first.rms_px[rivals] <= second.rms_px)
    for mine, others in ((first.T_camera_board, second.T_camera_board), (first.good, second.good)):
        mine[rivals[better]] = others[better]
    first.rms_px[rivals[better]] = second.rms_px[better]
    return first


def inlier_corners(T: NDArray[np.float64], lens: NDArray[np.float64], corners: Corners) -> NDArray[np.bool_]:
    """(N, M) which corners are no farther off than the noise of their own view explains."""
    off = np.linalg.norm(reprojection(T, lens, corners)[0], axis=2)
    # Of a normal error in two coordinates, the median length is 1.177 standard deviations.
    some = corners.seen | ~corners.seen.any(axis=1, keepdims=True)  # a view of nothing has no median
    sigma = np.nanmedian(np.where(some, off, np.nan), axis=1) / 1.177
    return corners.seen & (off <= CORNER_LIMIT * np.maximum(sigma, LEAST_NOISE_PX)[:, None])


def refine_poses(
    T: NDArray[np.float64], lens: NDArray[np.float64], corners: Corners, good: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The poses (N, 4, 4) near `T` with the least reprojection error of the corners `good` (N, M) by `lens`."""
    damping = np.full(len(T), 1e-4)
    now = pixel_blocks(T, lens, corners, good)
    for _ in range(STEPS):
        H = now.information[:, :6, :6].copy()
        diagonal = np.einsum("nii->ni", H)
        diagonal += damping[:, None] * diagonal + 1e-9
        step = solve_stack(H, now.pull[:, :6])
        tried = pose_from_twist(step) @ T
        then = pixel_blocks(tried, lens, corners, good)
        better = then.squares <= now.squares
        damping = np.where(better, damping * 0.1, damping * 10)
        T = np.where(better[:, None, None], tried, T)
        gain = np.where(better, now.squares - then.squares, 0.0)
        if (gain <= 1e-10 * now.squares + 1e-20).all():
            break
        now = PixelBlocks(
            np.where(better[:, None, None], then.information, now.information),
            np.where(better[:, None], then.pull, now.pull),
            np.where(better, then.squares, now.squares),
        )
    return T


def _two_poses(points: NDArray[np.float64], pixels: NDArray[np.float64], K: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2, 4, 4) NaN where OpenCV finds none: of corners in a line, or that are no board's."""
    import cv2

    guesses = np.full((2, 4, 4), np.nan)
    try:
        _, turns, shifts, errors = cv2.solvePnPGeneric(points, pixels[:, None], K, None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return guesses
    # The better one comes first; the other is worth a look only if it is nearly as good.
    rivals = len(turns) > 1 and float(errors[1, 0]) < RIVAL * float(errors[0, 0]) + LEAST_NOISE_PX
    for k, (turn, shift) in enumerate(zip(turns[: 1 + rivals], shifts, strict=False)):
        v = np.concatenate([turn.ravel(), shift.ravel()]).astype(np.float64)
        if np.isfinite(v).all() and v[5] > 0:
            guesses[k] = pose_from_twist(v)
    return guesses


def _refined(T: NDArray[np.float64], corners: Corners) -> BoardPoses:
    """Levenberg-Marquardt of all views at once, each with its own damping; then again without what does not fit."""
    found = np.asarray(np.isfinite(T).all(axis=(1, 2)))
    T = np.where(found[:, None, None], T, AHEAD)
    lens = np.zeros(LENS)
    good = corners.seen & found[:, None]
    for _ in range(2):
        T = refine_poses(T, lens, corners, good)
        good = inlier_corners(T, lens, corners) & found[:, None]
    T = refine_poses(T, lens, corners, good)
    counts = good.sum(axis=1)
    found = found & (counts >= np.maximum(FEWEST_CORNERS, corners.seen.sum(axis=1) / 2))
    squares = pixel_blocks(T, lens, corners, good).squares
    rms = np.sqrt(squares / np.maximum(2 * counts, 1))
    return BoardPoses(np.where(found[:, None, None], T, np.nan), good, np.where(found, rms, np.nan))
