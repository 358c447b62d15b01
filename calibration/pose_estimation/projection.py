"""Project board corners into the image, with Jacobians with respect to board pose, lens and board scale."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.observations import Observations

N_CORRECTIONS = 5
"""Number of entries of a vector `corrections`, which all views share.

The entries are relative changes of fx and fy, shifts of cx and cy in focal lengths, and the logarithm of the board
scale. They are zero for the reported camera matrix and the nominal board size.
"""
MAX_UNDISTORT_ITERATIONS = 1000
"""Maximum number of iterations to undistort a pixel."""
UNDISTORT_TOLERANCE_PX = 1e-9
"""Error of the redistorted pixel at which the undistortion stops, pixels."""
MIN_DEPTH_M = 1e-3
"""Lower limit of the corner depth, metres. Early solver steps can move the board behind the camera."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of N views of one board with M points."""

    points: NDArray[np.float64]
    """(M, 3) points of the board at its nominal size, board frame, metres."""
    pixels: NDArray[np.float64]
    """(N, M, 2) undistorted positions of the corners, pixels; zero where a corner was not detected."""
    seen: NDArray[np.bool_]
    """(N, M) mask, True where a corner was detected."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix reported by the camera, pixels."""

    @property
    def middle(self) -> NDArray[np.float64]:
        """(3,) middle of the board (mean of its points), board frame, metres."""
        return self.points.mean(axis=0)


def stack_corners(observations: Observations) -> Corners:
    """Return the undistorted corners of all views as arrays."""
    points = observations.board.points
    pixels = np.zeros((len(observations.views), len(points), 2))
    seen = np.zeros(pixels.shape[:2], dtype=bool)
    for k, view in enumerate(observations.views):
        pixels[k, view.ids] = _undistort(view.pixels, observations)
        seen[k, view.ids] = True
    return Corners(points, pixels, seen, observations.K)


def camera_matrix(K: NDArray[np.float64], corrections: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pinhole matrix `K` (3, 3), pixels, corrected by the vector `corrections` (N_CORRECTIONS,)."""
    result = K.copy()
    focal = K[[0, 1], [0, 1]]
    result[[0, 1], [0, 1]] = focal * (1 + corrections[:2])
    result[:2, 2] = K[:2, 2] + focal * corrections[2:4]
    return result


def reprojection_residuals(
    T_camera_board: NDArray[np.float64], corrections: NDArray[np.float64], corners: Corners
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the reprojection residuals and the positions of all corners.

    Args:
        T_camera_board: (N, 4, 4) board poses in the camera frame.
        corrections: (N_CORRECTIONS,) corrections of the camera matrix and of the board scale.
        corners: The corners of N views.

    Returns:
        Residuals (N, M, 2), measured minus predicted, pixels; zero where a corner was not detected.
        Positions (N, M, 3) of all corners in the camera frame, metres.
    """
    K = camera_matrix(corners.K, corrections)
    R = T_camera_board[:, :3, :3]
    t = T_camera_board[:, None, :3, 3]
    p = np.exp(corrections[4]) * corners.points @ R.swapaxes(1, 2) + t
    p[..., 2] = np.maximum(p[..., 2], MIN_DEPTH_M)
    pixels = p[..., :2] / p[..., 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
    return np.where(corners.seen[..., None], corners.pixels - pixels, 0.0), p


@dataclass(frozen=True, eq=False)
class PixelNormalEquations:
    """Normal equations `H @ step = g` of each view, for a corner noise of one pixel.

    The step is a board motion in the camera frame, rotation (rad), then translation (m), followed by a change of the
    N_CORRECTIONS parameters.
    """

    H: NDArray[np.float64]
    """(N, 6 + N_CORRECTIONS, 6 + N_CORRECTIONS) information matrices J^T J."""
    g: NDArray[np.float64]
    """(N, 6 + N_CORRECTIONS) right-hand sides J^T r."""
    squares_px2: NDArray[np.float64]
    """(N,) sum of the squared residuals of each view, px^2."""


def pixel_normal_equations(
    T_camera_board: NDArray[np.float64],
    corrections: NDArray[np.float64],
    corners: Corners,
    used: NDArray[np.bool_],
) -> PixelNormalEquations:
    """Linearise the reprojection residuals of each view.

    Args:
        T_camera_board: (N, 4, 4) board poses in the camera frame. A motion `c` (6,) moves the board to
            `pose_from_twist(c) @ T_camera_board`.
        corrections: (N_CORRECTIONS,) corrections of the camera matrix and of the board scale.
        corners: The corners of N views.
        used: (N, M) mask of the corners to use.
    """
    r, p = reprojection_residuals(T_camera_board, corrections, corners)
    J = pixel_jacobian(T_camera_board, corrections, corners, p) * np.tile(used, 2)[:, None]
    r = np.where(used[..., None], r, 0.0).swapaxes(1, 2).reshape(len(r), -1)
    return PixelNormalEquations(J @ J.swapaxes(1, 2), np.matvec(J, r), (r**2).sum(axis=1))


def pixel_jacobian(
    T_camera_board: NDArray[np.float64], corrections: NDArray[np.float64], corners: Corners, p: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the transposed Jacobians of the predicted pixels with respect to board motion and corrections.

    Args:
        T_camera_board: (N, 4, 4) board poses in the camera frame. The board motion multiplies from the left.
        corrections: (N_CORRECTIONS,) corrections of the camera matrix and of the board scale.
        corners: The corners of N views.
        p: (N, M, 3) positions of the corners in the camera frame, metres, from `reprojection_residuals`.

    Returns:
        (N, 6 + N_CORRECTIONS, 2 M) transposed Jacobians. The columns are u of all corners, then v of all corners.
    """
    focal = corners.K[[0, 1], [0, 1]]
    fx, fy = focal * (1 + corrections[:2])
    z = p[..., 2]
    x = p[..., 0] / z
    y = p[..., 1] / z
    from_origin = p - T_camera_board[:, None, :3, 3]
    zero = np.zeros_like(z)
    one = np.ones_like(z)
    # The rows are rotation, translation, focal lengths, principal point and board scale.
    u_rows = [-fx * x * y, fx * (1 + x * x), -fx * y, fx / z, zero, -fx * x / z]
    u_rows += [focal[0] * x, zero, focal[0] * one, zero]
    u_rows += [fx * (from_origin[..., 0] - x * from_origin[..., 2]) / z]
    v_rows = [-fy * (1 + y * y), fy * x * y, fy * x, zero, fy / z, -fy * y / z]
    v_rows += [zero, focal[1] * y, zero, focal[1] * one]
    v_rows += [fy * (from_origin[..., 1] - y * from_origin[..., 2]) / z]
    return np.concatenate([np.stack(u_rows, axis=1), np.stack(v_rows, axis=1)], axis=2)


def jacobian_of_seen(jacobian: NDArray[np.float64], seen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the Jacobian (2 K, P) of the pixels of K corners in one view: u of all corners, then v of all corners.

    Args:
        jacobian: (P, 2 M) transposed Jacobian of the view, from `pixel_jacobian`.
        seen: (M,) mask of the K corners.
    """
    n_parameters = len(jacobian)
    u_and_v = jacobian.reshape(n_parameters, 2, len(seen))
    return u_and_v[:, :, seen].reshape(n_parameters, -1).T


def _undistort(pixels: NDArray[np.float64], observations: Observations) -> NDArray[np.float64]:
    """Return the undistorted positions (N, 2) of corners at `pixels` (N, 2)."""
    if not np.any(observations.distortion) or not len(pixels):
        return pixels
    import cv2

    # OpenCV's default of five iterations leaves errors of whole pixels at the edge of a strongly distorted image.
    stop = (
        cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS,
        MAX_UNDISTORT_ITERATIONS,
        UNDISTORT_TOLERANCE_PX,
    )
    corners = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    undistorted = cv2.undistortPointsIter(
        corners, observations.K, observations.distortion, np.eye(3), observations.K, stop
    )
    return undistorted.reshape(-1, 2).astype(np.float64)
