"""Scatter of the measured depth, taken from the table."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.preprocessing.plane_fit import mode_sigma

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
CELL_ROW = 1_000_003
"""Factor of x in the number of a cell, more than the number of cells along y."""
MIN_CELLS = 30
"""Minimum number of cells for the error of a patch."""
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
    patch_m: float = 0.0
    """Standard deviation of the mean height of cells of edge length 2 r, metres; 0 if unknown. Averaging over pixels
    does not reduce it."""


def max_scatter_m(parameters: ChainParameters) -> float:
    """Return the scatter of the depth, one sigma, with which two depths can differ by the radius r, metres."""
    return parameters.r / (DIFFERENCE_SIGMAS * float(np.sqrt(2)))


def table_scatter(
    points: NDArray[np.float64], table_z_m: float, parameters: ChainParameters, is_aligned: bool
) -> TableScatter:
    """Return the scatter of the table in one view.

    An error of the pose is no scatter: the view is aligned to the table, or the deviations are from a plane of its own.
    A slow warp of the depth over the image is scatter, because it also moves strings.

    Args:
        points: (N, 3) evenly spread points of the view in the workspace, base frame, metres.
        table_z_m: Height of the table plane, metres, base frame.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        is_aligned: Whether the points are aligned to the table plane.
    """
    points = points[np.abs(points[:, 2] - table_z_m) < RANGE_RADII * parameters.z_t]
    if len(points) < MIN_TABLE_POINTS:
        return TableScatter()
    residual = points[:, 2] - (table_z_m if is_aligned else _fit_plane(points))
    x, y = np.floor(points[:, :2] / (2 * parameters.r)).astype(np.int64).T
    _, cell, count = np.unique(x * CELL_ROW + y, return_inverse=True, return_counts=True)
    means = np.bincount(cell, residual) / count
    # The mean of a cell also has the independent part of the errors of its pixels.
    within = np.bincount(cell, residual**2) / count - means**2
    is_full = count >= max(np.median(count), 2)
    patch_m = 0.0
    if is_full.sum() >= MIN_CELLS:
        independent = np.median(within[is_full] / (count[is_full] - 1))
        patch_m = float(np.sqrt(max(mode_sigma(means[is_full]) ** 2 - independent, 0.0)))
    return TableScatter(mode_sigma(residual), patch_m)


def _fit_plane(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the height (N,) of the plane of least absolute deviations at each point (N, 3)."""
    A = np.column_stack([points[:, :2] - points[:, :2].mean(axis=0), np.ones(len(points))])
    chosen = slice(None, None, -(-len(points) // MAX_POINTS))
    B, z = A[chosen], points[chosen, 2]
    plane = np.array([0.0, 0.0, np.median(z)])
    for _ in range(FIT_PASSES):
        weight = 1 / np.maximum(np.abs(z - B @ plane), MIN_DEVIATION_M)
        plane = np.linalg.lstsq((B * weight[:, None]).T @ B, (B * weight[:, None]).T @ z, rcond=None)[0]
    return np.asarray(A @ plane, dtype=np.float64)
