"""Surface beside a strand that is on no string: what the strand may be a part of."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.refinement.refinement import FittedStrand

BESIDE_RADII = (2.0, 3.0)
"""Distances from the centre line, in radii, between which other surface lies beside a strand."""
MAX_BESIDE_SHARE = 0.5
"""Maximum share of a strand that lies alone with other surface beside it.

An excluded strand that lies alone may be a string of another radius. In simulated scans with strings of two radii, or
with a wrong radius, excluded strings had up to 0.25, rarely 0.6. Edges of boxes had 0.75 and more, mostly 1.
"""
MAX_UNEVEN_SHARE = 0.65
"""Maximum share of a short string with uneven surface on both sides.

In simulated scans, ridges of a rough heap had 0.8 and more. Strings between boxes and along walls had up to 0.51 in
their worst 40 radii.
"""
MIN_UNEVEN_RADII = 0.5
"""Minimum height difference, from the 10th to the 90th percentile, of uneven surface beside a strand, in radii.

In simulated scans it was 1.5 to 3.4 beside ridges of a rough heap, and up to 0.05 beside strings on a plate.
"""


def is_ridge(strand: FittedStrand, others: Sequence[FittedStrand], surface: NDArray[np.float64], r: float) -> bool:
    """Return whether uneven surface lies on both sides of a strand, apart from the surface of other strands."""
    beside = _surface_beside(strand, others, surface, r)
    if len(beside) == 0:
        return False
    radius = max(strand.radius_m, r)
    along = np.gradient(strand.points, axis=0)[:, :2]
    left = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True).clip(min=1e-9)
    near = KDTree(beside).query_ball_point(strand.points, BESIDE_RADII[1] * radius)
    # Heights on both sides of the points that have surface on both sides, one after the other.
    heights: list[float] = []
    for k, indices in enumerate(near):
        to_left = (beside[indices, :2] - strand.points[k, :2]) @ left[k]
        z = beside[indices, 2]
        z_left = z[to_left > radius]
        z_right = z[to_left < -radius]
        if len(z_left) and len(z_right):
            heights += [float(np.median(z_left)), float(np.median(z_right))]
    n_between = len(heights) // 2
    if n_between <= MAX_UNEVEN_SHARE * len(strand.points):
        return False
    low, high = np.percentile(heights, (10, 90))
    return bool(high - low >= MIN_UNEVEN_RADII * radius)


def lies_alone(strand: FittedStrand, kept: Sequence[FittedStrand], surface: NDArray[np.float64], r: float) -> bool:
    """Return whether hardly any surface lies beside a strand, apart from the surface of the kept strands."""
    beside = _surface_beside(strand, kept, surface, r)
    if len(beside) == 0:
        return True
    reach = BESIDE_RADII[1] * max(strand.radius_m, r)
    return float(np.mean(KDTree(beside).query(strand.points)[0] < reach)) <= MAX_BESIDE_SHARE


def _surface_beside(
    strand: FittedStrand, others: Sequence[FittedStrand], surface: NDArray[np.float64], r: float
) -> NDArray[np.float64]:
    """Return the surface points (N, 3) beside a strand, without the surface of other strands."""
    radius = max(strand.radius_m, r)
    distance, _ = KDTree(strand.points).query(surface, distance_upper_bound=2 * BESIDE_RADII[1] * radius)
    beside = surface[np.isfinite(distance) & (np.asarray(distance) > BESIDE_RADII[0] * radius)]
    if not others or len(beside) == 0:
        return beside
    tree = KDTree(np.vstack([other.points for other in others]))
    reach = BESIDE_RADII[0] * max(r, *(other.radius_m for other in others))
    return beside[tree.query(beside)[0] > reach]
