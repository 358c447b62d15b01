"""Gaps between the axes of bands in an image, in which a string goes on although it is measured too low.

Matching windows lower short parts of a string almost to the table, and change its width beside crossings. Neither part
has an axis of its own.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.depth_correction.band_axes import across
from recognition.depth_correction.string_bands import StringBands

AHEAD_RADII = 2.5
"""Distance ahead of an axis point within which its axis goes on, in radii r."""
ASIDE_RADII = 1.0
"""Maximum distance of the next axis point from the straight line ahead, in radii r."""
MIN_AHEAD_RADII = 0.3
"""Distance below which another axis point is beside, not ahead, in radii r."""
MAX_GAP_RADII = 9.0
"""Maximum length of a gap, in radii r."""
MIN_GAP_HEIGHT = 0.15
"""Minimum median height between the axes, in 2 r. The bare table is lower."""
MIN_FACING = np.cos(np.radians(30))
"""Minimum cosine between an axis at its end and the line to the other end."""
MIN_OPPOSITE = np.cos(np.radians(45))
"""Minimum cosine between an axis at its end and the direction in which the other axis begins."""
MIN_LENGTH_PX = 1e-9
"""Lower limit of the length by which a line is divided, pixels."""
STEP_RADII = 0.5
"""Step of the axis points across a gap, in radii r."""


@dataclass(frozen=True, eq=False)
class _Ends:
    """Ends of axes."""

    point: NDArray[np.float64]
    """(E, 2) last axis point, pixels."""
    outward: NDArray[np.float64]
    """(E, 2) unit vector out of the axis."""


def bridge_gaps(bands: StringBands) -> StringBands:
    """Return the bands with straight axes across the gaps between axes that face each other."""
    ends = _axis_ends(bands)
    is_used = np.zeros(len(ends.point), dtype=np.bool_)
    points = [bands.axis]
    tangents = [bands.tangent]
    for pair in _facing_pairs(ends, bands.r_px):
        start, end = ends.point[pair]
        if is_used[pair].any() or not _shows_string(start, end, bands):
            continue
        is_used[pair] = True
        length = float(np.linalg.norm(end - start))
        share = np.linspace(0, 1, int(length / (STEP_RADII * bands.r_px)) + 2)[1:-1]
        points.append(start + share[:, None] * (end - start))
        tangents.append(np.tile((end - start) / length, (len(share), 1)))
    axis = np.vstack(points)
    zeros = np.zeros(len(axis) - len(bands.axis))
    return replace(
        bands,
        axis=axis,
        tangent=np.vstack(tangents),
        curvature=np.append(bands.curvature, zeros),
        across_rise=np.append(bands.across_rise, zeros),
        axis_tops_m=np.append(bands.axis_tops_m, zeros + bands.compression * bands.diameter_m),
        axis_slopes=np.append(bands.axis_slopes, zeros),
    )


def _shows_string(start: NDArray[np.float64], end: NDArray[np.float64], bands: StringBands) -> bool:
    """Return whether the gap between two axis points (2,) is higher than the table."""
    heights = _heights_between(start, end, bands)
    return len(heights) > 0 and float(np.median(heights)) > MIN_GAP_HEIGHT * bands.diameter_m


def _axis_ends(bands: StringBands) -> _Ends:
    """Return the axis points beyond which no axis goes on."""
    points = np.vstack([bands.axis, bands.axis])
    outward = np.vstack([bands.tangent, -bands.tangent])
    neighbours = KDTree(bands.axis).query_ball_point(points, AHEAD_RADII * bands.r_px)
    row = np.repeat(np.arange(len(points)), [len(near) for near in neighbours])
    offset = bands.axis[np.concatenate(neighbours).astype(np.intp)] - points[row]
    ahead = np.vecdot(offset, outward[row])
    aside = np.abs(np.vecdot(offset, across(outward[row])))
    goes_on = (ahead > MIN_AHEAD_RADII * bands.r_px) & (aside < ASIDE_RADII * bands.r_px)
    is_end = np.bincount(row, goes_on, minlength=len(points)) == 0
    return _Ends(points[is_end], outward[is_end])


def _facing_pairs(ends: _Ends, r_px: float) -> NDArray[np.intp]:
    """Return the pairs (P, 2) of ends that face each other, the nearest first."""
    if len(ends.point) == 0:
        return np.empty((0, 2), dtype=np.intp)
    pairs = KDTree(ends.point).query_pairs(MAX_GAP_RADII * r_px, output_type="ndarray").astype(np.intp)
    first, second = pairs.T
    line = ends.point[second] - ends.point[first]
    length = np.linalg.norm(line, axis=1)
    direction = line / np.maximum(length, MIN_LENGTH_PX)[:, None]
    faces = np.vecdot(direction, ends.outward[first]) > MIN_FACING
    faces &= np.vecdot(direction, ends.outward[second]) < -MIN_FACING
    faces &= np.vecdot(ends.outward[first], ends.outward[second]) < -MIN_OPPOSITE
    return pairs[faces][np.argsort(length[faces], kind="stable")]


def _heights_between(start: NDArray[np.float64], end: NDArray[np.float64], bands: StringBands) -> NDArray[np.float32]:
    """Return the heights (N,) of the pixels within a radius of the line between two axis points, metres."""
    height, width = bands.heights.shape
    low = np.floor(np.minimum(start, end) - bands.r_px).clip(0, (width, height)).astype(np.intp)
    high = (np.ceil(np.maximum(start, end) + bands.r_px) + 1).clip(0, (width, height)).astype(np.intp)
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    line = end - start
    length = float(np.linalg.norm(line))
    offset = np.stack([u, v], axis=-1) - start
    along = offset @ line / length
    aside = np.abs(offset @ across(line)) / length
    return bands.heights[v, u][(along > 0) & (along < length) & (aside < bands.r_px)]
