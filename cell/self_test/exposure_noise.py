"""Noise of single exposures of a table at rest, and what the median of several exposures leaves of it.

The table is the largest plane in view. It is found in the images, without a calibration.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.camera.frame_averaging import median
from cell.camera_profile.table_pixels import MIN_TABLE_SHARE, find_table

COUNTS = (1, 3, 5)
"""Numbers of exposures that are compared."""
NOISE_MARGIN = 0.05
"""Largest excess of the noise on the table over that of the largest number of exposures, relative to that."""
FLICKER_MARGIN = 0.01
"""Largest excess of the flicker over that of the largest number of exposures, as a share of the edge pixels."""

JUMP_M = 0.005
"""Smallest change of the depth at an edge that counts as flicker."""
MIN_EDGE_PIXELS = 500
"""Smallest number of edge pixels for a statement about flicker. A hundredth of them is then five pixels."""


@dataclass(frozen=True)
class MedianNoise:
    """Noise of views that are the median of a number of exposures."""

    exposures: int
    """Number of exposures of a view."""
    temporal_m: float
    """Standard deviation of a pixel's depth over the views, root mean square over the table, along the optical axis."""
    total_m: float
    """Root mean square of the fixed and the temporal noise together."""
    flicker_share: float | None
    """Share of the edge pixels that jump, appear or disappear from one view to the next. None: too few edges."""


@dataclass(frozen=True)
class ExposureNoise:
    """Noise of a camera at rest in front of a table."""

    fixed_m: float
    """Distance between table and plane that all exposures share, root mean square, along the optical axis."""
    table_pixels: int
    """Number of pixels of the table that every exposure measured, away from edges."""
    edge_pixels: int
    """Number of pixels near edges that at least one exposure measured."""
    medians: tuple[MedianNoise, ...]
    """Noise by number of exposures, in the order of `COUNTS`."""


def measure_noise(depth: NDArray[np.uint16], depth_unit_m: float) -> ExposureNoise | None:
    """Return the noise of exposures of a scene at rest, or None if no plane fills enough of the image.

    Args:
        depth: Depth images (N, H, W), at least 10, in depth units; 0 = not measured.
        depth_unit_m: Metres per depth count.
    """
    middle = median(list(depth)) * depth_unit_m
    found = find_table(middle)
    if found is None:
        return None
    flat = found.table & depth.all(axis=0)
    edges = found.edges & depth.any(axis=0)
    if flat.sum() < MIN_TABLE_SHARE * middle.size:
        return None
    on_table, at_edges = depth[:, flat], depth[:, edges]
    single_m2 = float(np.mean(np.var(on_table * depth_unit_m, axis=0, ddof=1)))
    residual_m = on_table.mean(axis=0) * depth_unit_m - found.plane_m[flat]
    # the mean of N exposures still has their noise, divided by N
    fixed_m2 = float(np.mean(residual_m**2)) - single_m2 / len(depth)
    fixed_m = float(np.sqrt(max(fixed_m2, 0.0)))
    enough = int(edges.sum()) >= MIN_EDGE_PIXELS
    medians = []
    for count in COUNTS:
        temporal_m = _temporal_noise(_views(on_table, count) * depth_unit_m)
        flicker_share = _flicker(_views(at_edges, count) * depth_unit_m) if enough else None
        medians.append(MedianNoise(count, temporal_m, float(np.hypot(fixed_m, temporal_m)), flicker_share))
    return ExposureNoise(fixed_m, int(flat.sum()), int(edges.sum()), tuple(medians))


def recommended_exposures(noise: ExposureNoise) -> int | None:
    """Return the smallest number of exposures that is as good as the largest, or None if the flicker is unknown.

    Compared with the largest number, its noise on the table is at most 5 % larger (`NOISE_MARGIN`), and its flicker
    affects at most one more in a hundred edge pixels (`FLICKER_MARGIN`).
    """
    last = noise.medians[-1]
    for candidate in noise.medians:
        if candidate.flicker_share is None or last.flicker_share is None:
            return None
        quiet = candidate.total_m <= (1 + NOISE_MARGIN) * last.total_m
        if quiet and candidate.flicker_share <= last.flicker_share + FLICKER_MARGIN:
            return candidate.exposures
    return last.exposures


def _views(depth: NDArray[np.uint16], count: int) -> NDArray[np.uint16]:
    """Return the median of each group of `count` exposures in a row (N // count, M), of exposures (N, M)."""
    firsts = range(0, len(depth) - count + 1, count)
    return np.stack([median(list(depth[first : first + count])) for first in firsts])


def _temporal_noise(views_m: NDArray[np.floating[Any]]) -> float:
    """Return the root mean square over all pixels of the standard deviation over the views (V, M)."""
    return float(np.sqrt(np.mean(np.var(views_m, axis=0, ddof=1))))


def _flicker(views_m: NDArray[np.floating[Any]]) -> float:
    """Return the share of the pixels (V, M) that differ between one view and the next, the mean of all pairs."""
    before, after = views_m[:-1], views_m[1:]
    lost = (before > 0) != (after > 0)
    jumped = (before > 0) & (after > 0) & (np.abs(after - before) > JUMP_M)
    return float(np.mean(lost | jumped))
