"""Warp of a depth camera: measure its slow depth error over the image on the table, and correct depth images.

The inverse depth of a plane is a linear function of the image coordinates. What deviates from such a function in the
same way in all images is an error of the camera. What deviates in the same way at a place of the table is its relief,
for example a mat: each cell of the table has a free height, so that no relief is taken for a warp. The constant and the
linear part of the warp look like an error of the pose and are not measured here; the alignment to the table and the
registration remove most of their effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from recognition.preprocessing.table_measurement import ViewPlane, pixels_near_table
from recognition.preprocessing.target_cloud import DepthView, Scene

DEGREE = 5
"""Maximum degree of the polynomials of the warp. It describes three half periods across the image."""
TERMS = tuple((i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j >= 2)
"""Degrees of the polynomials along the rows and along the columns of the image."""
SAMPLE_SIZE = 1500
"""Approximate number of pixels per view after even subsampling. Their errors are nearly independent."""
NEAR_M = 0.006
"""Maximum distance of points from the plane of the table, metres. They may lie on flat objects."""
CELL_M = 0.015
"""Edge length of the cells of the table, metres. Each has a free height."""
CELL_ROW = 1_000_003
"""Factor of x in the number of a cell, more than the number of cells along y."""
INLIER_SIGMAS = 3.0
"""Maximum deviation of the inverse depth from the model, in sigmas. Pixels at edges of flat objects deviate more."""
N_PASSES = 4
"""Number of passes of the fit, each with the inliers of the one before."""
MIN_ABOVE_M = 0.05
"""Minimum height of the camera above the table in the derivatives, metres."""
MIN_PIXELS = 300
"""Minimum number of pixels on the table in a view that contributes."""
MIN_VIEWS = 4
"""Minimum number of views. Fewer views hardly show whether the deviation is one of the camera."""
MAX_VIEWS = 8
"""Maximum number of views from which the warp is measured: the first ones. Further views hardly change it."""
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
MIN_DEPTH_FACTOR = 0.5
"""Minimum ratio of a corrected depth to a measured one, and of the reverse: the error far from the table is unknown."""


@dataclass(frozen=True, eq=False)
class TableSample:
    """Pixels of one view near its plane of the table, and how their inverse depths depend on the unknowns."""

    inverse_depth: NDArray[np.float64]
    """(N,) inverse depths, 1/m."""
    linear: NDArray[np.float64]
    """(N, 3) derivatives with respect to the plane of the view: a linear function of the image coordinates."""
    terms: NDArray[np.float64]
    """(N, J) derivatives with respect to the coefficients of the warp: the polynomials `TERMS`."""
    by_height: NDArray[np.float64]
    """(N,) derivatives with respect to the height of the table at the pixel, 1/m^2."""
    cell: NDArray[np.int64]
    """(N,) number of the cell of the table."""
    depth_moments: NDArray[np.float64]
    """(J, J) second moments of the depth errors that coefficients of one cause, m^4."""


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


def sample_table(view: DepthView, plane: ViewPlane, scene: Scene) -> TableSample | None:
    """Return pixels of a view near the table, or None if it shows too little of it.

    Args:
        view: Depth image with its camera pose.
        plane: Plane of the table in the view.
        scene: Given table height, and sides of the workspace.
    """
    rows, columns, points = pixels_near_table(view, scene, SAMPLE_SIZE)
    height_m = points[:, 2] - plane.centre[2] - (points[:, :2] - plane.centre[:2]) @ plane.slope
    near = np.abs(height_m) < NEAR_M
    if near.sum() < MIN_PIXELS:
        return None
    rows, columns, points = rows[near], columns[near], points[near]
    depth_m = view.depth[rows, columns] * view.depth_unit_m
    by_row, by_column = (
        legvander(_across(x, n), DEGREE) for x, n in zip((rows, columns), view.depth.shape, strict=True)
    )
    terms = np.column_stack([by_row[:, i] * by_column[:, j] for i, j in TERMS])
    by_depth = depth_m[:, None] ** 2 * terms
    # Of the plane, because derivatives with the noise of the depths would explain this noise.
    above_m = view.T_base_camera[2, 3] - (points[:, 2] - height_m[near])
    slant = (view.T_base_camera[2, 3] - points[:, 2]) / depth_m
    x, y = np.floor(points[:, :2] / CELL_M).astype(np.int64).T
    return TableSample(
        inverse_depth=1 / depth_m,
        linear=np.column_stack([np.ones(len(rows)), by_row[:, 1], by_column[:, 1]]).astype(np.float64),
        terms=terms,
        by_height=slant / np.maximum(above_m, MIN_ABOVE_M) ** 2,
        cell=x * CELL_ROW + y,
        depth_moments=by_depth.T @ by_depth / len(by_depth),
    )


def measure_warp(views: Sequence[TableSample]) -> DepthWarp | None:
    """Return the warp that all views show, or None if it is small or may be due to chance.

    The planes of the views, the heights of the cells and the coefficients of the warp are fitted together. If the views
    contradict each other more than the noise explains, the covariance of the warp grows in proportion. If they
    contradict each other more than the warp explains, there is no warp.

    Args:
        views: Samples of the views that show the table.
    """
    if len(views) < MIN_VIEWS:
        return None
    views = views[:MAX_VIEWS]
    count, n_planes = len(TERMS), 3 * len(views)
    y = np.concatenate([view.inverse_depth for view in views])
    view_of_pixel = np.repeat(np.arange(len(views)), [len(view.inverse_depth) for view in views])
    A = np.zeros((len(y), n_planes + count))
    for k, view in enumerate(views):
        A[view_of_pixel == k, 3 * k : 3 * k + 3] = view.linear
    A[:, n_planes:] = np.vstack([view.terms for view in views])
    by_height = np.concatenate([view.by_height for view in views])
    _, cell = np.unique(np.concatenate([view.cell for view in views]), return_inverse=True)
    prior, used, sigma = np.eye(count) / PRIOR_PER_M**2, np.ones(len(y), dtype=bool), 1e-3
    columns = np.column_stack([A, y])
    terms, deviation = _without_table(columns, by_height, cell, n_planes)
    for _ in range(N_PASSES):
        residual = deviation - terms @ np.linalg.solve(terms.T @ terms + sigma**2 * prior, terms.T @ deviation)
        sigma = max(1.4826 * float(np.median(np.abs(residual))), 1e-6)
        used[used] = np.abs(residual) < INLIER_SIGMAS * sigma
        terms, deviation = _without_table(columns[used], by_height[used], cell[used], n_planes)
    rows = [view_of_pixel[used] == k for k in range(len(views))]
    H = np.array([terms[row].T @ terms[row] for row in rows]) / sigma**2
    g = np.array([terms[row].T @ deviation[row] for row in rows]) / sigma**2
    warp, scale, squares = np.zeros(count), 1.0, np.zeros(len(views))
    for _ in range(3):
        warp = np.linalg.solve(prior + H.sum(axis=0) / scale, g.sum(axis=0) / scale)
        contradiction = g - H @ warp
        squares = np.vecdot(contradiction, np.linalg.solve(H + prior, contradiction[..., None])[..., 0])
        scale = max(float(squares.sum()) / (count * (len(views) - 1)), 1.0)
    explained = float(warp @ H.sum(axis=0) @ warp)
    is_chance = explained / scale < count + MAX_CHANCE_SIGMAS * np.sqrt(2 * count)
    is_contradicted = float(squares.sum()) > explained
    rms_m = _rms_on_table(warp, views)
    return None if is_chance or is_contradicted or rms_m < MIN_WARP_M else DepthWarp(warp, rms_m)


def is_similar(a: DepthWarp | None, b: DepthWarp | None, views: Sequence[TableSample]) -> bool:
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
    error = depth_m * warp.inverse_depth_error((view.depth.shape[0], view.depth.shape[1]))
    depth_m /= np.clip(1 - error, MIN_DEPTH_FACTOR, 1 / MIN_DEPTH_FACTOR)
    unit_m = min(view.depth_unit_m, float(depth_m.max(initial=0.0)) / np.iinfo(np.uint16).max or view.depth_unit_m)
    counts = np.clip(np.rint(depth_m / unit_m), 0, np.iinfo(np.uint16).max)
    return CorrectedView(view.index, counts.astype(np.uint16), unit_m, view.K, view.T_base_camera)


def _rms_on_table(coefficients: NDArray[np.float64], views: Sequence[TableSample]) -> float:
    """Return the root mean square of the depth error on the table that the coefficients (J,) cause, metres."""
    return float(np.sqrt(np.mean([coefficients @ view.depth_moments @ coefficients for view in views])))


def _without_table(
    columns: NDArray[np.float64], by_height: NDArray[np.float64], cell: NDArray[np.int64], n_planes: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the terms (N, J) and the values (N,) without what relief and planes of the table explain.

    Args:
        columns: (N, n_planes + J + 1) derivatives by the planes of the views, the terms, and the values.
        by_height: (N,) derivatives of the values by the heights of the cells.
        cell: (N,) numbers of the cells.
        n_planes: Number of columns of the planes.
    """
    squares = np.bincount(cell, by_height**2)
    sums = np.stack([np.bincount(cell, by_height * column) for column in columns.T], axis=1)
    columns = columns - by_height[:, None] * (sums / np.maximum(squares, 1e-12)[:, None])[cell]
    planes, rest = columns[:, :n_planes], columns[:, n_planes:]
    # The heights of the cells contain the mean of all planes, so the equations of the planes may be singular.
    rest = rest - planes @ np.linalg.lstsq(planes.T @ planes, planes.T @ rest, rcond=1e-9)[0]
    return rest[:, :-1], rest[:, -1]


def _across(pixels: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Return positions (N,) of pixel centres from -1 to 1 across `count` pixels."""
    return (2 * pixels + 1) / count - 1
