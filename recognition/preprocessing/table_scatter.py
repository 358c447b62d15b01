"""Scatter of the measured depth, taken from the table."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.preprocessing.plane_fit import clipped_sigma, mode_sigma

MAX_POINTS = 1000
"""Maximum number of points in the fit of the plane. It is robust, so this is enough."""
FIT_PASSES = 5
"""Number of passes of the fit of the plane by least absolute deviations."""
MIN_DEVIATION_M = 0.0002
"""Deviation from the plane below which all points have the same weight in the fit, metres."""
RANGE_RADII = 4.0
"""Maximum distance of a table point from the nominal table, as a multiple of the height threshold z_t."""
MIN_TABLE_POINTS = 100
"""Minimum number of table points. With fewer, the scatter is unknown and counts as zero."""
PATCHES = 400
"""Approximate number of patches of an image in which the correlation of neighbouring pixels is measured."""
PATCH_PIXELS = 16
"""Maximum number of pixels of a patch that are read."""
MIN_PATCH_SHARE = 0.75
"""Minimum share of the pixels of a patch that are on the table. Other patches do not count."""
MIN_PATCHES = 30
"""Minimum number of patches. With fewer, the error of a patch is unknown."""
DIFFERENCE_SIGMAS = 3.0
"""Minimum string radius, in sigmas of the difference between two depths. With more noise, two views can differ by the
radius although nothing moved."""
THRESHOLD_SIGMAS = 3.0
"""Minimum height threshold z_t, in sigmas of single pixels. With more noise, some pixels of the table are above it."""
NOISE_ADVICE = (
    "Move the viewpoints nearer, use a higher resolution or more exposures, give the table more texture or light, or "
    "use thicker strings"
)
"""What to do against depth noise."""


@dataclass(frozen=True)
class TableScatter:
    """Scatter of the depth of one view, measured on the table."""

    pixel_m: float = 0.0
    """Standard deviation of the height of single pixels about the table plane, metres; 0 if unknown."""
    patch_m: float | None = None
    """Standard deviation of the mean height of patches of edge length 2 r, metres, without the part that is independent
    in each pixel; None if unknown. Averaging over pixels does not reduce it."""


def median_patch_m(scatters: Iterable[TableScatter]) -> float | None:
    """Return the median scatter of patches over the views in which it is known, metres; None if it is in none."""
    known = [scatter.patch_m for scatter in scatters if scatter.patch_m is not None]
    return float(np.median(known)) if known else None


def max_scatter_m(parameters: ChainParameters) -> float:
    """Return the scatter of the depth, one sigma, with which two depths can differ by the radius r, metres."""
    return parameters.r / (DIFFERENCE_SIGMAS * float(np.sqrt(2)))


def patch_pixels(shape: tuple[int, ...], edge_px: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns (M, n) of the pixels of patches that are spread evenly over an image.

    The pixels of a patch are a random sample, so their distances are those of all its pixels on average.

    Args:
        shape: Height and width of the image, pixels.
        edge_px: Edge length of a patch, pixels.
    """
    edge = int(np.clip(np.rint(edge_px), 2, min(shape)))
    step = max(int(np.sqrt(shape[0] * shape[1] / PATCHES)), 1)
    corners = np.mgrid[: shape[0] - edge + 1 : step, : shape[1] - edge + 1 : step].reshape(2, -1, 1)
    chosen = np.random.default_rng(0).choice(edge**2, min(edge**2, PATCH_PIXELS), replace=False)
    rows, columns = corners + np.array(np.divmod(chosen, edge))[:, None]
    return rows, columns


def table_scatter(
    points: NDArray[np.float64],
    patches: NDArray[np.float64],
    table_z_m: float,
    parameters: ChainParameters,
    is_aligned: bool,
) -> TableScatter:
    """Return the scatter of the table in one view.

    An error of the pose is no scatter: the view is aligned to the table, or the deviations are from a plane of its own.
    A slow warp of the depth over the image is scatter, because it also moves strings.

    Args:
        points: (N, 3) evenly spread points of the view in the workspace, base frame, metres.
        patches: (M, n, 3) points of neighbouring pixels in patches of edge length 2 r, not a number where nothing in
            the workspace is measured.
        table_z_m: Height of the table plane, metres, base frame.
        parameters: Method parameters; uses the height threshold z_t.
        is_aligned: Whether the points are aligned to the table plane.
    """
    range_m = RANGE_RADII * parameters.z_t
    points = points[np.abs(points[:, 2] - table_z_m) < range_m]
    if len(points) < MIN_TABLE_POINTS:
        return TableScatter()
    plane = np.array([0.0, 0.0, table_z_m])
    if not is_aligned:
        plane = _fit_plane(points)
    is_table = np.abs(patches[..., 2] - table_z_m) < range_m
    patch_heights = np.where(is_table, _heights(patches, plane), np.nan)
    return TableScatter(pixel_m=mode_sigma(_heights(points, plane)), patch_m=_patch_sigma(patch_heights))


def _patch_sigma(heights: NDArray[np.float64]) -> float | None:
    """Return the standard deviation of the mean of each patch (M, n), metres, or None if there are too few patches."""
    measured = np.isfinite(heights)
    count = measured.sum(axis=1)
    enough = count >= max(MIN_PATCH_SHARE * heights.shape[1], 2)
    if enough.sum() < MIN_PATCHES:
        return None
    heights = heights[enough]
    measured = measured[enough]
    count = count[enough]
    mean = np.nansum(heights, axis=1) / count
    # The mean of a patch also has the independent part of the errors of its pixels.
    within = np.where(measured, heights - mean[:, None], 0.0)
    independent = float(np.median((within**2).sum(axis=1) / ((count - 1) * count)))
    return float(np.sqrt(max(clipped_sigma(mean) ** 2 - independent, 0.0)))


def _heights(points: NDArray[np.float64], plane: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the heights (...,) of points (..., 3) above a plane (slope along x, slope along y, height), metres."""
    return np.asarray(points[..., 2] - points[..., :2] @ plane[:2] - plane[2], dtype=np.float64)


def _fit_plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the plane (slope along x, slope along y, height) of least absolute deviations from points (N, 3)."""
    middle = points[:, :2].mean(axis=0)
    chosen = points[:: -(-len(points) // MAX_POINTS)]
    B = np.column_stack([chosen[:, :2] - middle, np.ones(len(chosen))])
    z = chosen[:, 2]
    plane = np.array([0.0, 0.0, np.median(points[:, 2])])
    for _ in range(FIT_PASSES):
        weight = 1 / np.maximum(np.abs(z - B @ plane), MIN_DEVIATION_M)
        weighted_B = B * weight[:, None]
        plane = np.linalg.lstsq(weighted_B.T @ B, weighted_B.T @ z, rcond=None)[0]
    return np.asarray(plane - (0.0, 0.0, plane[:2] @ middle), dtype=np.float64)
