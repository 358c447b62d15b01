"""Warp of a depth camera: measure its slow depth error over the image on the table, and correct depth images.

The inverse depth of a plane is a linear function of the image coordinates. If the table is flat, what deviates from
such a function in the same way in all views is an error of the camera. The constant and the linear part of the warp
look like an error of the pose and are not measured here; the alignment to the table and the registration remove most of
their effect. A table that is not flat looks like a warp only if it looks alike in all images.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from recognition.preprocessing.table_measurement import ViewPlane
from recognition.preprocessing.target_cloud import MAX_REACH_M, DepthView, Scene, deproject

DEGREE = 5
"""Maximum degree of the polynomials of the warp. It describes three half periods across the image."""
TERMS = tuple((i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j >= 2)
"""Degrees of the polynomials along the rows and along the columns of the image."""
SAMPLE_SIZE = 1500
"""Approximate number of pixels per view after even subsampling. Their errors are nearly independent."""
INLIERS_M = (0.006, 0.004, 0.002, 0.002)
"""Maximum deviation of the depth of the table from the model in each pass of the fit, metres."""
MIN_PIXELS = 300
"""Minimum number of pixels on the table in a view that contributes."""
MIN_VIEWS = 4
"""Minimum number of views. Fewer views hardly show whether the deviation is one of the camera."""
PRIOR_PER_M = 0.02
"""Prior standard deviation of a coefficient of the warp, 1/m: 0.3 pixels of disparity for a baseline of 20 mm and a
focal length of 800 pixels, and more for a longer baseline."""
MAX_CHANCE_SIGMAS = 4.0
"""Maximum number of standard deviations by which the significance of a warp exceeds its expectation by chance."""
MIN_WARP_M = 0.0002
"""Minimum root mean square of the depth error on the table for which images are corrected, metres."""
MAX_CHANGE_M = 0.0001
"""Maximum root mean square of the difference of two warps on the table for which views are not corrected again,
metres."""
MAX_CHANGE_SHARE = 0.1
"""The same as a share of the warp. A larger warp is known less exactly."""


@dataclass(frozen=True, eq=False)
class WarpEquations:
    """Normal equations of the warp from one view, after elimination of its plane of the table."""

    H: NDArray[np.float64]
    """(J, J) information matrix of the coefficients, for the noise of this view."""
    g: NDArray[np.float64]
    """(J,) right-hand side."""
    depth_moments: NDArray[np.float64]
    """(J, J) second moments of the depth errors on the table that coefficients of one cause, m^4."""


@dataclass(frozen=True, eq=False)
class DepthWarp:
    """Slow depth error of a camera over its image."""

    coefficients: NDArray[np.float64]
    """(J,) coefficients of the polynomials `TERMS`: the error of the inverse depth, 1/m."""
    rms_m: float
    """Root mean square of the depth error on the table, metres."""

    def inverse_depth_error(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the error (H, W) of the inverse depth of each pixel of an image, 1/m."""
        by_row, by_column = (legvander(_across(np.arange(n), n), DEGREE) for n in shape)
        C = np.zeros((DEGREE + 1, DEGREE + 1))
        C[tuple(np.transpose(TERMS))] = self.coefficients
        return np.asarray(by_row @ C @ by_column.T, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class CorrectedView:
    """View with a corrected depth image."""

    index: int
    """Number of the view."""
    depth: NDArray[np.uint16]
    """(H, W) corrected depth image."""
    depth_unit_m: float
    """Metres per depth count: at most as large as in the captured view, so that rounding adds no error."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose, metres."""


def warp_equations(view: DepthView, plane: ViewPlane, scene: Scene) -> WarpEquations | None:
    """Return the normal equations of the warp from one view, or None if it shows too little of the table.

    Args:
        view: Depth image with its camera pose.
        plane: Plane of the table in the view.
        scene: Sides of the workspace.
    """
    rows, columns = _pixels_near(view, plane, scene)
    depth_m = view.depth[rows, columns] * view.depth_unit_m
    by_row, by_column = (
        legvander(_across(x, n), DEGREE) for x, n in zip((rows, columns), view.depth.shape, strict=True)
    )
    linear = np.column_stack([np.ones(len(rows)), by_row[:, 1], by_column[:, 1]])
    A = np.column_stack([linear, *(by_row[:, i] * by_column[:, j] for i, j in TERMS)])
    prior = np.diag([0.0] * 3 + [1 / PRIOR_PER_M**2] * len(TERMS))
    solution, sigma, used = np.zeros(A.shape[1]), 0.0, np.ones(len(rows), dtype=bool)
    for distance_m in INLIERS_M:
        if used.sum() < MIN_PIXELS:
            return None
        H, g = A[used].T @ A[used], A[used].T @ (1 / depth_m[used])
        solution = np.linalg.solve(H + sigma**2 * prior + 1e-12 * np.eye(len(H)), g)
        residual = 1 / depth_m - A @ solution
        used = np.abs(residual) * depth_m**2 < distance_m
        sigma = 1.4826 * float(np.median(np.abs(residual[used]))) if used.any() else 0.0
    if used.sum() < MIN_PIXELS:
        return None
    A, q = A[used], 1 / depth_m[used]
    H, g = A.T @ A, A.T @ q
    eliminated = np.linalg.solve(H[:3, :3], np.column_stack([H[:3, 3:], g[:3]]))
    by_depth = depth_m[used, None] ** 2 * A[:, 3:]
    variance = max(sigma, 1e-6) ** 2
    return WarpEquations(
        H=(H[3:, 3:] - H[3:, :3] @ eliminated[:, :-1]) / variance,
        g=(g[3:] - H[3:, :3] @ eliminated[:, -1]) / variance,
        depth_moments=by_depth.T @ by_depth / len(by_depth),
    )


def measure_warp(views: Sequence[WarpEquations]) -> DepthWarp | None:
    """Return the warp that all views show, or None if it is small or may be due to chance.

    If the views contradict each other more than the noise explains, the covariance of the warp grows in proportion.

    Args:
        views: Normal equations of the views that show the table.
    """
    if len(views) < MIN_VIEWS:
        return None
    count = len(TERMS)
    prior = np.eye(count) / PRIOR_PER_M**2
    H, g = np.array([view.H for view in views]), np.array([view.g for view in views])
    warp, scale = np.zeros(count), 1.0
    for _ in range(3):
        warp = np.linalg.solve(prior + H.sum(axis=0) / scale, g.sum(axis=0) / scale)
        contradiction = g - H @ warp
        squares = np.vecdot(contradiction, np.linalg.solve(H + prior, contradiction[..., None])[..., 0])
        scale = max(float(squares.sum()) / (count * (len(views) - 1)), 1.0)
    significance = float(warp @ H.sum(axis=0) @ warp) / scale
    rms_m = _rms_on_table(warp, views)
    by_chance = significance < count + MAX_CHANCE_SIGMAS * np.sqrt(2 * count)
    return None if by_chance or rms_m < MIN_WARP_M else DepthWarp(warp, rms_m)


def is_similar(a: DepthWarp | None, b: DepthWarp | None, views: Sequence[WarpEquations]) -> bool:
    """Return whether two warps, or none, give nearly the same depth of the table in the views."""
    if a is None or b is None:
        return a is b
    return _rms_on_table(a.coefficients - b.coefficients, views) < max(MAX_CHANGE_M, MAX_CHANGE_SHARE * b.rms_m)


def correct(view: DepthView, warp: DepthWarp) -> CorrectedView:
    """Return the view without the warp.

    Args:
        view: Captured view.
        warp: Warp of its camera.
    """
    depth_m = view.depth * view.depth_unit_m
    depth_m /= 1 - depth_m * warp.inverse_depth_error((view.depth.shape[0], view.depth.shape[1]))
    unit_m = min(view.depth_unit_m, float(depth_m.max(initial=0.0)) / np.iinfo(np.uint16).max or view.depth_unit_m)
    counts = np.clip(np.rint(depth_m / unit_m), 0, np.iinfo(np.uint16).max)
    return CorrectedView(view.index, counts.astype(np.uint16), unit_m, view.K, view.T_base_camera)


def _rms_on_table(coefficients: NDArray[np.float64], views: Sequence[WarpEquations]) -> float:
    """Return the root mean square of the depth error on the table that the coefficients (J,) cause, metres."""
    return float(np.sqrt(np.mean([coefficients @ view.depth_moments @ coefficients for view in views])))


def _pixels_near(view: DepthView, plane: ViewPlane, scene: Scene) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows (N,) and the columns (N,) of evenly subsampled pixels near the plane of the table."""
    step = int(np.ceil(np.sqrt(max(view.depth.size / SAMPLE_SIZE, 1.0))))
    rows, columns = (x * step + step // 2 for x in np.nonzero(view.depth[step // 2 :: step, step // 2 :: step]))
    points = deproject(view, rows, columns)
    sides = np.array([[-MAX_REACH_M, MAX_REACH_M]] * 2 if scene.workspace_m is None else scene.workspace_m[:2])
    height_m = points[:, 2] - plane.centre[2] - (points[:, :2] - plane.centre[:2]) @ plane.slope
    is_inside = np.all((points[:, :2] >= sides[:, 0]) & (points[:, :2] <= sides[:, 1]), axis=1)
    near = is_inside & (np.abs(height_m) < INLIERS_M[0])
    return rows[near], columns[near]


def _across(pixels: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Return positions (N,) of pixel centres from -1 to 1 across `count` pixels."""
    return (2 * pixels + 1) / count - 1
