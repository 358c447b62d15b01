"""Where the camera ought to see the board's corners, and how that changes with everything that is solved for."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.observations import Observations

LENS = 5
"""Numbers that all views share besides the two poses: shares of fx and fy, shifts of cx and cy in focal lengths, and
the logarithm of the board's scale."""
UNDISTORTING_STEPS, UNDISTORTED_PX = 1000, 1e-9
"""A pixel is straightened until, distorted again, it is as near as this to where it was, in so many steps at most."""
NEAREST_M = 1e-3
"""Corners nearer than this, or behind the camera, are taken to be here: the first steps may lead there."""


@dataclass(frozen=True, eq=False)
class Corners:
    """The corners of N views of one board with M points."""

    points: NDArray[np.float64]
    """(M, 3) board frame, as told."""
    pixels: NDArray[np.float64]
    """(N, M, 2) without distortion; zero where not seen."""
    seen: NDArray[np.bool_]
    """(N, M)."""
    K: NDArray[np.float64]
    """(3, 3) as told."""

    @property
    def middle(self) -> NDArray[np.float64]:
        """(3,) the board's middle, board frame."""
        return self.points.mean(axis=0)


def stack_corners(observations: Observations) -> Corners:
    """The corners as arrays, undistorted."""
    points = observations.board.points
    pixels = np.zeros((len(observations.views), len(points), 2))
    seen = np.zeros(pixels.shape[:2], dtype=bool)
    for k, view in enumerate(observations.views):
        pixels[k, view.ids] = _undistorted(view.pixels, observations)
        seen[k, view.ids] = True
    return Corners(points, pixels, seen, observations.K)


def camera_matrix(K: NDArray[np.float64], lens: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3, 3) the told one, changed by `lens` (LENS,)."""
    result = K.copy()
    focal = K[[0, 1], [0, 1]]
    result[[0, 1], [0, 1]] = focal * (1 + lens[:2])
    result[:2, 2] = K[:2, 2] + focal * lens[2:4]
    return result


def reprojection(T_camera_board: NDArray[np.float64], lens: NDArray[np.float64], corners: Corners):
    """How far each corner is seen from where it ought to be (N, M, 2), and where it is in the camera (N, M, 3)."""
    K = camera_matrix(corners.K, lens)
    R, t = T_camera_board[:, :3, :3], T_camera_board[:, None, :3, 3]
    p = np.exp(lens[4]) * corners.points @ R.swapaxes(1, 2) + t
    p[..., 2] = np.maximum(p[..., 2], NEAREST_M)
    pixels = p[..., :2] / p[..., 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
    return np.where(corners.seen[..., None], corners.pixels - pixels, 0.0), p


@dataclass(frozen=True, eq=False)
class PixelBlocks:
    """The corners' normal equations, view by view, for pixels of unit noise: of the board's small motion in the
    camera's frame (6) and the lens and board (LENS)."""

    information: NDArray[np.float64]
    """(N, 11, 11)."""
    pull: NDArray[np.float64]
    """(N, 11): J^T r; the step is information^-1 @ pull."""
    squares: NDArray[np.float64]
    """(N,) sum of the squared residuals, px^2."""


def pixel_blocks(
    T_camera_board: NDArray[np.float64],
    lens: NDArray[np.float64],
    corners: Corners,
    used: NDArray[np.bool_],
) -> PixelBlocks:
    """The normal equations of the corners `used` (N, M) around `T_camera_board` (N, 4, 4) and `lens` (LENS,).

    The board's motion `c` is from the left: `small_motion(c) @ T_camera_board`.
    """
    r, p = reprojection(T_camera_board, lens, corners)
    J = pixel_jacobian(T_camera_board, lens, corners, p) * np.tile(used, 2)[:, None]
    r = np.where(used[..., None], r, 0.0).swapaxes(1, 2).reshape(len(r), -1)
    return PixelBlocks(J @ J.swapaxes(1, 2), (J @ r[..., None])[..., 0], (r**2).sum(axis=1))


def pixel_jacobian(
    T_camera_board: NDArray[np.float64], lens: NDArray[np.float64], corners: Corners, p: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N, 6 + LENS, 2 M) how the board's small motion, from the left, and the lens move every corner's u, then v.

    The corners are at `p` (N, M, 3) in the camera, as `reprojection` tells.
    """
    told = corners.K[[0, 1], [0, 1]]
    fx, fy = told * (1 + lens[:2])
    x, y, z = p[..., 0] / p[..., 2], p[..., 1] / p[..., 2], p[..., 2]
    from_origin = p - T_camera_board[:, None, :3, 3]
    nothing, one = np.zeros_like(z), np.ones_like(z)
    # Of u, then of v: by the turn, the shift, the focal lengths, the centre and the scale.
    by_u = [-fx * x * y, fx * (1 + x * x), -fx * y, fx / z, nothing, -fx * x / z]
    by_u += [told[0] * x, nothing, told[0] * one, nothing]
    by_u += [fx * (from_origin[..., 0] - x * from_origin[..., 2]) / z]
    by_v = [-fy * (1 + y * y), fy * x * y, fy * x, nothing, fy / z, -fy * y / z]
    by_v += [nothing, told[1] * y, nothing, told[1] * one]
    by_v += [fy * (from_origin[..., 1] - y * from_origin[..., 2]) / z]
    return np.concatenate([np.stack(by_u, axis=1), np.stack(by_v, axis=1)], axis=2)


def _undistorted(pixels: NDArray[np.float64], observations: Observations) -> NDArray[np.float64]:
    if not np.any(observations.distortion) or not len(pixels):
        return pixels
    import cv2

    # Its usual five steps leave pixels of error at the edge of a strongly distorted picture.
    to_the_end = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, UNDISTORTING_STEPS, UNDISTORTED_PX)
    corners = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    flat = cv2.undistortPointsIter(
        corners, observations.K, observations.distortion, np.eye(3), observations.K, to_the_end
    )
    return flat.reshape(-1, 2).astype(np.float64)
