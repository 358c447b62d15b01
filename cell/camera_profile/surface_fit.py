"""Fit the table in several depth images together: a plane for each pose, one slow warp, and one pixel locking."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from cell.camera_profile.table_pixels import image_positions
from recognition.depth_correction.pixel_locking import LockingSample, PixelLocking, measure_locking
from recognition.preprocessing.plane_fit import median_sigma

DEGREE = 5
"""Largest degree of the slow polynomials along each axis. It describes three half periods across the image."""
TERMS = tuple((i, j) for i, j in product(range(DEGREE + 1), repeat=2) if i + j >= 2)
"""Degrees of the slow polynomials along the rows and along the columns of the image."""
SAMPLE_SIZE = 6000
"""Approximate number of pixels per pose in the fit."""
N_PASSES = 3
"""Number of passes. Each excludes the outliers of the one before, and corrects the pixel locking that it found."""
INLIER_SIGMAS = 3.0
"""Largest error of a pixel in the fit, in standard deviations."""
MIN_SIGMA_PER_M = 1e-9
"""Smallest standard deviation of the errors, 1/m. It keeps the pixels of an exact plane."""
MIN_SINGULAR_SHARE = 1e-6
"""Share of the largest singular value below which one counts as zero, where the table fills a part of the image."""


@dataclass(frozen=True, eq=False)
class TableImage:
    """Inverse depths of the table from one pose."""

    inverse_depth: NDArray[np.float64]
    """(N,) inverse depths of the pixels on the table, 1/m, the mean of all images of the pose."""
    rows: NDArray[np.intp]
    """(N,) rows of the pixels."""
    columns: NDArray[np.intp]
    """(N,) columns of the pixels."""
    shape: tuple[int, int]
    """Height and width of the image."""


@dataclass(frozen=True, eq=False)
class SurfaceFit:
    """What the tables of all poses have in common, and the rest."""

    planes: tuple[NDArray[np.float64], ...]
    """(3,) inverse depth of the plane of each pose, as factors of `image_positions`, 1/m."""
    locking: PixelLocking | None
    """Pixel locking, or None if there is none."""
    warp: tuple[NDArray[np.float64], ...]
    """(N,) slow error of the inverse depth at the pixels of each pose, 1/m."""
    ripple: tuple[NDArray[np.float64], ...]
    """(N,) error of the inverse depth without plane and warp, 1/m."""
    rest: tuple[NDArray[np.float64], ...]
    """(N,) the same without pixel locking, 1/m."""


def fit_surfaces(images: Sequence[TableImage]) -> SurfaceFit:
    """Return planes, warp, pixel locking and remaining errors of the tables.

    Args:
        images: Tables of the poses, each with more pixels than unknowns.
    """
    samples = [_subsampled(image) for image in images]
    A = _design(samples)
    inverse_depth = np.concatenate([sample.inverse_depth for sample in samples])
    is_inlier = np.ones(len(inverse_depth), dtype=bool)
    locking: PixelLocking | None = None
    unknowns = np.zeros(A.shape[1])
    for _ in range(N_PASSES):
        locked = np.zeros(len(inverse_depth)) if locking is None else locking.error(inverse_depth)
        solution = np.linalg.lstsq(A[is_inlier], (inverse_depth - locked)[is_inlier], rcond=MIN_SINGULAR_SHARE)[0]
        unknowns = np.asarray(solution, dtype=np.float64)
        ripple = inverse_depth - A @ unknowns
        rest = ripple - locked
        is_inlier = np.abs(rest) <= INLIER_SIGMAS * max(median_sigma(rest), MIN_SIGMA_PER_M)
        locking = measure_locking([LockingSample(inverse_depth[is_inlier], ripple[is_inlier])])
    return _split(images, unknowns, locking)


def _split(images: Sequence[TableImage], unknowns: NDArray[np.float64], locking: PixelLocking | None) -> SurfaceFit:
    """Return the errors of all pixels for fitted planes and warp."""
    count = len(images)
    planes = [unknowns[3 * k : 3 * k + 3] for k in range(count)]
    slow = _slow_image(unknowns[3 * count :], images[0].shape)
    warp = [slow[image.rows, image.columns] for image in images]
    ripple = []
    rest = []
    for image, plane, error in zip(images, planes, warp, strict=True):
        without = image.inverse_depth - image_positions(image.rows, image.columns, image.shape) @ plane - error
        locked = np.zeros(len(without)) if locking is None else locking.error(image.inverse_depth)
        ripple.append(without)
        rest.append(without - locked)
    return SurfaceFit(tuple(planes), locking, tuple(warp), tuple(ripple), tuple(rest))


def _subsampled(image: TableImage) -> TableImage:
    """Return about `SAMPLE_SIZE` of the pixels, at random so that no stripe is favoured."""
    count = len(image.inverse_depth)
    if count <= SAMPLE_SIZE:
        return image
    chosen = np.sort(np.random.default_rng(0).choice(count, SAMPLE_SIZE, replace=False))
    return TableImage(image.inverse_depth[chosen], image.rows[chosen], image.columns[chosen], image.shape)


def _design(samples: Sequence[TableImage]) -> NDArray[np.float64]:
    """Return the derivatives (N, 3 * poses + J) of all inverse depths by the planes and the slow terms."""
    count = len(samples)
    A = np.zeros((sum(len(sample.inverse_depth) for sample in samples), 3 * count + len(TERMS)))
    first = 0
    for k, sample in enumerate(samples):
        rows = slice(first, first + len(sample.inverse_depth))
        A[rows, 3 * k : 3 * k + 3] = image_positions(sample.rows, sample.columns, sample.shape)
        A[rows, 3 * count :] = _slow_terms(sample)
        first = rows.stop
    return A


def _slow_terms(image: TableImage) -> NDArray[np.float64]:
    """Return the slow polynomials (N, J) at the pixels of an image."""
    height, width = image.shape
    by_row = legvander((2 * image.rows + 1) / height - 1, DEGREE)
    by_column = legvander((2 * image.columns + 1) / width - 1, DEGREE)
    return np.column_stack([by_row[:, i] * by_column[:, j] for i, j in TERMS])


def _slow_image(coefficients: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the sum (H, W) of the slow polynomials with these coefficients (J,)."""
    height, width = shape
    by_row = legvander((2 * np.arange(height) + 1) / height - 1, DEGREE)
    by_column = legvander((2 * np.arange(width) + 1) / width - 1, DEGREE)
    C = np.zeros((DEGREE + 1, DEGREE + 1))
    C[tuple(np.transpose(TERMS))] = coefficients
    return by_row @ C @ by_column.T
