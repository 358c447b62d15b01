"""Distances between strands on the table that keep them apart."""

from collections.abc import Sequence

import numpy as np

from cell.simulation.scenes.planar_crossings import Curves, PlanCrossing, is_closed, near_pairs

MIN_ANGLE_RAD = np.deg2rad(32.0)
"""Smallest angle of a crossing. Strands at smaller angles touch side by side, which is another scene."""
END_CLEARANCE = 6.0
"""Smallest distance of a crossing from a string's end, along the string, in radii."""
CROSSING_CLEARANCE = 6.0
"""Smallest distance between two crossings, in radii."""
MIN_SIDE_CLEARANCE = 2.4
"""Smallest distance of the centre lines of two strands that do not cross, in radii, at which they nearly touch."""
SIDE_CLEARANCE = 4.5
"""Default of this distance, with more than the width of a string of table between two strands."""


def clear(
    plan: Curves,
    crossings: Sequence[PlanCrossing],
    radius_m: float,
    clearance: float,
    growing: bool = False,
    min_angle_rad: float = MIN_ANGLE_RAD,
    since: int = 0,
) -> bool:
    """Return whether crossings are steep enough and away from ends and from each other, and other strands are apart.

    Args:
        plan: Courses (N, 2) in even steps.
        crossings: All crossings of the courses.
        radius_m: Radius of the strings.
        clearance: Smallest distance of strands that do not cross, in radii.
        growing: Whether the last string grows, so that its end may be near a strand that it will cross.
        min_angle_rad: Smallest angle of a crossing.
        since: Index of the last string's point before which all strands are known to be apart.
    """
    last = len(plan) - 1
    for crossing in crossings:
        if crossing.angle_rad < min_angle_rad:
            return False
        for string, position in (crossing.first, crossing.second):
            behind = len(plan[string]) - 1 - position
            to_end = position if growing and string == last else min(position, behind)
            if to_end * step_of(plan[string]) < END_CLEARANCE * radius_m:
                return False
    if len(crossings) > 1:
        points = np.array([crossing.point for crossing in crossings])
        apart = np.linalg.norm(points[:, None] - points[None], axis=2)
        if apart[np.triu_indices(len(points), 1)].min() < CROSSING_CLEARANCE * radius_m:
            return False
    return strands_apart(plan, crossings, clearance * radius_m, growing, min_angle_rad, since)


def strands_apart(
    plan: Curves,
    crossings: Sequence[PlanCrossing],
    apart_m: float,
    growing: bool = False,
    min_angle_rad: float = MIN_ANGLE_RAD,
    since: int = 0,
) -> bool:
    """Return whether strands are nearer than `apart_m` only where they cross."""
    string = np.repeat(np.arange(len(plan)), [len(curve) for curve in plan])
    s = np.concatenate([np.arange(len(curve)) * step_of(curve) for curve in plan])
    tip_m = _reach(apart_m, min_angle_rad)
    if since:
        # points before the former tip have been checked, but not the tip itself
        since = len(s) - len(plan[-1]) + max(since - 2 - int(tip_m / step_of(plan[-1])), 0)
    i, j = near_pairs(np.vstack([curve[:, :2] for curve in plan]), apart_m, since)
    # along one strand, the arc of a chord is at most pi/2 times as long
    along = s[j] - s[i]
    whole = np.array([len(curve) * step_of(curve) if is_closed(curve) else np.inf for curve in plan])
    other = (string[i] != string[j]) | (np.minimum(along, whole[string[i]] - along) > apart_m * np.pi / 2)
    if growing:
        tip = (string == len(plan) - 1) & (s > s[-1] - tip_m)
        other &= ~tip[i] & ~tip[j]
    i, j = i[other], j[other]
    explained = np.zeros(len(i), dtype=bool)
    for crossing in crossings:
        reach = _reach(apart_m, crossing.angle_rad)
        (a, position_a), (b, position_b) = crossing.first, crossing.second
        near_a = np.abs(s[i] - position_a * step_of(plan[a])) < reach
        near_b = np.abs(s[j] - position_b * step_of(plan[b])) < reach
        explained |= (string[i] == a) & (string[j] == b) & near_a & near_b
    return bool(explained.all())


def deepest_overlap(curves: Curves, radii_m: Sequence[float]) -> float:
    """Return the largest overlap of two strands, relative to the sum of their radii. A negative value is a gap.

    The result is minus infinity if no two strands are near. The last radius of an end does not count, because an end is
    square and may butt against the side of a strand.

    Args:
        curves: Centre lines (N, 3) in even steps.
        radii_m: Radius of each string.
    """
    from scipy.spatial import KDTree

    if not curves:
        return -np.inf
    counts = [len(curve) for curve in curves]
    string = np.repeat(np.arange(len(curves)), counts)
    radius = np.repeat(np.asarray(radii_m, dtype=np.float64), counts)
    s = np.concatenate([np.arange(len(curve)) * step_of(curve) for curve in curves])
    whole = np.array([len(curve) * step_of(curve) if is_closed(curve) else np.inf for curve in curves])
    to_end = np.minimum(s, np.repeat(s[np.cumsum(counts) - 1], counts) - s)
    to_end[np.repeat([is_closed(curve) for curve in curves], counts)] = np.inf
    points = np.vstack(list(curves))
    i, j = KDTree(points).query_pairs(2.5 * max(radii_m), output_type="ndarray").T
    along = np.abs(s[j] - s[i])
    # points of one string are as near as this in its tightest bends
    other = (string[i] != string[j]) | (np.minimum(along, whole[string[i]] - along) > 1.2 * np.pi * radius[i])
    other &= (to_end[i] > radius[i]) & (to_end[j] > radius[j])
    i, j = i[other], j[other]
    thick = radius[i] + radius[j]
    return float((1 - np.linalg.norm(points[i] - points[j], axis=1) / thick).max(initial=-np.inf))


def step_of(curve: np.ndarray) -> float:
    """Return the step of a curve in even steps."""
    return float(np.linalg.norm(curve[1] - curve[0]))


def _reach(apart_m: float, angle_rad: float) -> float:
    """Return the distance from a crossing within which its two strands may be near each other, with room for bends."""
    return 1.6 * apart_m / float(np.sin(angle_rad))
