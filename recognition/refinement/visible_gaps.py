"""Visible gaps: places where the depth images show that no string is, because they measured what lies behind it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline, points_at, resampled_lengths
from recognition.preprocessing.lines_of_sight import count_views
from recognition.preprocessing.normals import NormalCloud
from recognition.strand import Strand

Points = NDArray[np.float64]

STEP_RADII = 0.25
"""Spacing of the examined points, in radii of the string."""
MIN_EXTENT_VIEWS = 2
"""Minimum number of views that look through the points around a free point that belong to the same gap."""
MIN_PART_RADII = 3.0
"""Minimum length of a part of a split strand, in radii. A shorter part shows no direction."""
MAX_SUPPORT_SHARE = 0.5
"""Maximum mean number of surface points on the tube in a gap, as a share of the median along the strand.

It was up to 0.25 in gaps between strings. Where the axis is inaccurate, as at a crossing in coarse images, views look
past a string that is there; the share was 1 and more.
"""
TUBE_RADII = (0.6, 1.35)
"""Range of the distances from the axis of surface on the tube, in radii."""


def split_at_visible_gaps(
    strands: Sequence[Strand], radii: NDArray[np.float64], surface: Points, views: Sequence[NormalCloud]
) -> list[Strand] | None:
    """Split the strands where half of the views look through their axis, and hardly any surface lies on their tube.

    Two strings that lie end to end with a short gap are traced as one strand. Their surfaces may be linked over the
    gap, but the lines of sight across the strings show it.

    The gap goes on around such a point as far as at least `MIN_EXTENT_VIEWS` views look through the axis. Some views
    may be wrong at the same point if a string is only a few pixels wide.

    Args:
        strands: Strands with fitted lines.
        radii: (K,) radius of each strand, metres.
        surface: (M, 3) registered surface points, metres, base frame.
        views: Registered views.

    Returns:
        The strands and the parts of split strands, without parts shorter than `MIN_PART_RADII`. None if no strand has a
        visible gap.
    """
    parts: list[Strand] = []
    is_split = False
    for strand, r in zip(strands, radii, strict=True):
        gaps = _visible_gaps(strand, float(r), surface, views)
        if len(gaps):
            is_split = True
            parts += _split(strand, gaps, MIN_PART_RADII * float(r))
        else:
            parts.append(strand)
    return parts if is_split else None


def _visible_gaps(strand: Strand, r: float, surface: Points, views: Sequence[NormalCloud]) -> NDArray[np.float64]:
    """Return the first and last arc lengths (M, 2) of the visible gaps of a strand, metres.

    The last radius of an open end is not examined, because the position of an end is uncertain by this much.
    """
    line = close_polyline(strand.points, strand.closed)
    s = resampled_lengths(line, STEP_RADII * r)
    axis = points_at(line, s)
    counts = count_views(axis, r, views)
    is_gap = counts.through >= MIN_EXTENT_VIEWS
    if not strand.closed:
        is_gap &= (s > r) & (s < s[-1] - r)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_gap, [False]])))
    runs = [slice(first, stop) for first, stop in zip(edges[::2], edges[1::2], strict=True)]
    gaps = [run for run in runs if counts.is_free[run].any()]
    if gaps:
        support = _count_on_tube(axis, r, surface)
        max_support = MAX_SUPPORT_SHARE * float(np.median(support))
        gaps = [gap for gap in gaps if support[gap].mean() < max_support]
    return np.array([(s[gap][0], s[gap][-1]) for gap in gaps]).reshape(-1, 2)


def _count_on_tube(points: Points, r: float, surface: Points) -> NDArray[np.int64]:
    """Return the numbers (N,) of surface points (M, 3) on a tube that are nearest to each point (N, 3) of its axis."""
    distance, nearest = KDTree(points).query(surface, distance_upper_bound=TUBE_RADII[1] * r)
    is_on_tube = np.isfinite(distance) & (np.asarray(distance) > TUBE_RADII[0] * r)
    return np.bincount(np.asarray(nearest)[is_on_tube], minlength=len(points))


def _split(strand: Strand, gaps: NDArray[np.float64], min_length: float) -> list[Strand]:
    """Return the parts of a strand between its gaps (M, 2) that are at least `min_length` metres long."""
    points = strand.points
    bridged = strand.bridged
    s = arc_length(points)
    if strand.closed:
        # The parts of a closed strand begin after its first gap.
        first = int(np.searchsorted(s, gaps[0, 1], side="right"))
        length = float(arc_length(close_polyline(points, True))[-1])
        s = np.concatenate([s[first:], s[:first] + length])
        points = np.roll(points, -first, axis=0)
        bridged = np.roll(bridged, -first)
        gaps = np.vstack([gaps[1:], gaps[:1] + length])
    # A part lies between the last arc length of a gap and the first one of the next gap.
    starts = np.concatenate([[-np.inf], gaps[:, 1]])
    stops = np.concatenate([gaps[:, 0], [np.inf]])
    parts = []
    for start, stop in zip(starts, stops, strict=True):
        part = (s > start) & (s < stop)
        if part.sum() > 2 and np.ptp(s[part]) >= min_length:
            parts.append(Strand(points[part], bridged[part]))
    return parts
