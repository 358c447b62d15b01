"""Warp of a depth camera: measure its slow depth error over the image on the table, and correct depth images.

The inverse depth of a plane is a linear function of the image coordinates. What deviates from such a function in the
same way in all images is an error of the camera. What deviates in the same way at a place of the table is its relief,
for example a mat: each cell of the table has a free height, so that no relief is taken for a warp. The constant and the
linear part of the warp look like an error of the pose and are not measured here; the alignment to the table and the
registration remove most of their effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from recognition.preprocessing.plane_fit import median_sigma
from recognition.preprocessing.table_measurement import ViewPlane, pixels_near_table
from recognition.preprocessing.target_cloud import DepthView, Scene, intensity_of

DEGREE = 5
"""Maximum degree of the polynomials of the warp. It describes three half periods across the image."""
TERMS = tuple((i, j) for i, j in product(range(DEGREE + 1), repeat=2) if 2 <= i + j <= DEGREE)
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
FIRST_SIGMA_PER_M = 1e-3
"""Standard deviation of the inverse depths in the first pass, 1/m. Later passes measure it."""
MIN_SIGMA_PER_M = 1e-6
"""Minimum standard deviation of the inverse depths, 1/m."""
MIN_SQUARES = 1e-12
"""Lower limit of the sum of the squared derivatives by the height of a cell. It keeps the division finite."""
MIN_SINGULAR_SHARE = 1e-9
"""Share of the largest singular value of the equations of the planes below which a singular value counts as zero."""
N_SCALE_PASSES = 3
"""Number of passes that estimate how much the views contradict each other."""
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
MAX_COUNT = int(np.iinfo(np.uint16).max)
"""Largest count of a depth image."""
FINEST_UNIT_M = 2e-5
"""Smallest depth unit of an image whose depths are corrected for stereo matching, metres."""
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
    limit_per_m: float = np.inf
    """Largest error of the inverse depth where the table was measured, 1/m. Beyond it, the polynomials are unknown."""

    def inverse_depth_error(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Return the error (H, W) of the inverse depth of each pixel of an image, 1/m."""
        by_row, by_column = (legvander(_across(np.arange(n), n), DEGREE) for n in shape)
        C = np.zeros((DEGREE + 1, DEGREE + 1))
        C[tuple(np.transpose(TERMS))] = self.coefficients
        error = by_row @ C @ by_column.T
        return np.clip(error, -self.limit_per_m, self.limit_per_m)


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
    intensity: NDArray[np.uint8] | None = None
    """(H, W) intensity image of the captured view, or None."""


def sample_table(view: DepthView, plane: ViewPlane, scene: Scene, size: int = SAMPLE_SIZE) -> TableSample | None:
    """Return pixels of a view near the table, or None if it shows too little of it.

    Args:
        view: Depth image with its camera pose.
        plane: Plane of the table in the view.
        scene: Given table height, and sides of the workspace.
        size: Approximate number of pixels after even subsampling.
    """
    rows, columns, points = pixels_near_table(view, scene, size)
    height_m = points[:, 2] - plane.centre[2] - (points[:, :2] - plane.centre[:2]) @ plane.slope
    near = np.abs(height_m) < NEAR_M
    if near.sum() < MIN_PIXELS:
        return None
    rows = rows[near]
    columns = columns[near]
    points = points[near]
    depth_m = view.depth[rows, columns] * view.depth_unit_m
    image_height, image_width = view.depth.shape
    by_row = legvander(_across(rows, image_height), DEGREE)
    by_column = legvander(_across(columns, image_width), DEGREE)
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
    H, g = _normal_equations(_stack_equations(views), len(views))
    fit = _combine_views(H, g)
    explained = float(fit.coefficients @ H.sum(axis=0) @ fit.coefficients)
    # By chance, it is a chi-square of as many degrees of freedom as terms.
    count = len(TERMS)
    is_chance = explained / fit.scale < count + MAX_CHANCE_SIGMAS * np.sqrt(2 * count)
    is_contradicted = fit.contradiction > explained
    rms_m = _rms_on_table(fit.coefficients, views)
    if is_chance or is_contradicted or rms_m < MIN_WARP_M:
        return None
    limit = max(float(np.abs(view.terms @ fit.coefficients).max()) for view in views)
    return DepthWarp(fit.coefficients, rms_m, limit)


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
    unit_m = view.depth_unit_m
    largest_m = float(depth_m.max(initial=0.0))
    if largest_m > 0:
        unit_m = min(unit_m, largest_m / MAX_COUNT)
    counts = np.clip(np.rint(depth_m / unit_m), 0, MAX_COUNT)
    return CorrectedView(view.index, counts.astype(np.uint16), unit_m, view.K, view.T_base_camera, intensity_of(view))


def finer_unit_m(unit_m: float, largest_m: float) -> float:
    """Return a depth unit for corrected depths, so fine that rounding adds no error, metres.

    Args:
        unit_m: Depth unit of the captured image, metres. The result is at most as large.
        largest_m: Largest corrected depth, metres.
    """
    return min(unit_m, max(largest_m / MAX_COUNT, FINEST_UNIT_M))


def _rms_on_table(coefficients: NDArray[np.float64], views: Sequence[TableSample]) -> float:
    """Return the root mean square of the depth error on the table that the coefficients (J,) cause, metres."""
    return float(np.sqrt(np.mean([coefficients @ view.depth_moments @ coefficients for view in views])))


@dataclass(frozen=True, eq=False)
class _PixelEquations:
    """Equations of the pixels of all views. Planes, relief and warp together cause the inverse depths."""

    columns: NDArray[np.float64]
    """(N, n_planes + J + 1) derivatives by the planes of the views, derivatives by the coefficients of the warp, and
    inverse depths, 1/m."""
    n_planes: int
    """Number of columns of the planes."""
    by_height: NDArray[np.float64]
    """(N,) derivatives by the heights of the cells, 1/m^2."""
    cell: NDArray[np.int64]
    """(N,) index of the cell of the table."""
    view: NDArray[np.int64]
    """(N,) index of the view."""

    def select(self, mask: NDArray[np.bool_]) -> "_PixelEquations":
        """Return the equations of the pixels in a mask (N,)."""
        return _PixelEquations(
            self.columns[mask], self.n_planes, self.by_height[mask], self.cell[mask], self.view[mask]
        )

    def without_table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the terms (N, J) and the inverse depths (N,) without what relief and planes of the table explain."""
        squares = np.bincount(self.cell, self.by_height**2)
        sums = np.stack([np.bincount(self.cell, self.by_height * column) for column in self.columns.T], axis=1)
        heights = sums / np.maximum(squares, MIN_SQUARES)[:, None]
        columns = self.columns - self.by_height[:, None] * heights[self.cell]
        planes = columns[:, : self.n_planes]
        rest = columns[:, self.n_planes :]
        # The heights of the cells contain the mean of all planes, so the equations of the planes may be singular.
        rest = rest - planes @ np.linalg.lstsq(planes.T @ planes, planes.T @ rest, rcond=MIN_SINGULAR_SHARE)[0]
        return rest[:, :-1], rest[:, -1]


@dataclass(frozen=True, eq=False)
class _CombinedWarp:
    """Warp that all views together show."""

    coefficients: NDArray[np.float64]
    """(J,) coefficients of the polynomials `TERMS`, 1/m."""
    scale: float
    """Factor of its covariance, at least 1: how much more the views contradict each other than the noise explains."""
    contradiction: float
    """Sum over the views of the squared differences to the common warp, in sigmas."""


def _stack_equations(views: Sequence[TableSample]) -> _PixelEquations:
    """Return the equations of the pixels of all views."""
    n_planes = 3 * len(views)
    view_of_pixel = np.repeat(np.arange(len(views)), [len(view.inverse_depth) for view in views])
    planes = np.zeros((len(view_of_pixel), n_planes))
    for k, view in enumerate(views):
        planes[view_of_pixel == k, 3 * k : 3 * k + 3] = view.linear
    terms = np.vstack([view.terms for view in views])
    inverse_depth = np.concatenate([view.inverse_depth for view in views])
    _, cell = np.unique(np.concatenate([view.cell for view in views]), return_inverse=True)
    return _PixelEquations(
        columns=np.column_stack([planes, terms, inverse_depth]),
        n_planes=n_planes,
        by_height=np.concatenate([view.by_height for view in views]),
        cell=cell,
        view=view_of_pixel,
    )


def _normal_equations(pixels: _PixelEquations, n_views: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the information matrix (V, J, J) and vector (V, J) of the warp in each view, from the inliers."""
    sigma = FIRST_SIGMA_PER_M
    terms, deviation = pixels.without_table()
    for _ in range(N_PASSES):
        warp = np.linalg.solve(terms.T @ terms + sigma**2 * _prior_information(), terms.T @ deviation)
        residual = deviation - terms @ warp
        sigma = max(median_sigma(residual), MIN_SIGMA_PER_M)
        pixels = pixels.select(np.abs(residual) < INLIER_SIGMAS * sigma)
        terms, deviation = pixels.without_table()
    rows = [pixels.view == k for k in range(n_views)]
    H = np.array([terms[row].T @ terms[row] for row in rows]) / sigma**2
    g = np.array([terms[row].T @ deviation[row] for row in rows]) / sigma**2
    return H, g


def _combine_views(H: NDArray[np.float64], g: NDArray[np.float64]) -> _CombinedWarp:
    """Return the warp from the information matrices (V, J, J) and vectors (V, J) of the views."""
    n_views, count = g.shape
    prior = _prior_information()
    warp = np.zeros(count)
    scale = 1.0
    contradiction = 0.0
    for _ in range(N_SCALE_PASSES):
        warp = np.linalg.solve(prior + H.sum(axis=0) / scale, g.sum(axis=0) / scale)
        difference = g - H @ warp
        squares = np.vecdot(difference, np.linalg.solve(H + prior, difference[..., None])[..., 0])
        contradiction = float(squares.sum())
        scale = max(contradiction / (count * (n_views - 1)), 1.0)
    return _CombinedWarp(warp, scale, contradiction)


def _prior_information() -> NDArray[np.float64]:
    """Return the prior information matrix (J, J) of the coefficients of the warp."""
    return np.eye(len(TERMS)) / PRIOR_PER_M**2


def _across(pixels: NDArray[np.intp], count: int) -> NDArray[np.float64]:
    """Return positions (N,) of pixel centres from -1 to 1 across `count` pixels."""
    return (2 * pixels + 1) / count - 1
