"""When strands on the table keep apart well enough to be told from one another."""

from collections.abc import Sequence

import numpy as np

from cell.simulation.crossings import Curves, PlanCrossing

MIN_ANGLE_RAD = np.deg2rad(32.0)
"""Strands cross at no smaller angle: flatter ones are contacts side by side, another scene."""
END_CLEARANCE = 6.0
"""Least distance of a crossing from a string's end, along the string, in radii."""
CROSSING_CLEARANCE = 6.0
"""Least distance of two crossings from one another, in radii."""
MIN_SIDE_CLEARANCE = 2.4
"""Least distance of the centre lines of two strands that do not cross there, in radii: just not touching."""
SIDE_CLEARANCE = 4.5
"""The same where nothing else is wished: a string's width and more of table between, as in a simply laid string."""


def clear(
    plan: Curves, crossings: Sequence[PlanCrossing], radius_m: float, clearance: float, growing: bool = False
) -> bool:
    """Whether crossings are steep enough, away from ends and from one another, and other strands apart.

    Apart is `clearance` radii. `plan` holds the strings' courses (N, 2) in even steps, `crossings` all their
    crossings. With `growing` the end of the last string is not its end yet: it may be near to another strand that
    it is about to cross.
    """
    last = len(plan) - 1
    for crossing in crossings:
        if crossing.angle_rad < MIN_ANGLE_RAD:
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
    return strands_apart(plan, crossings, clearance * radius_m, growing)


def strands_apart(plan: Curves, crossings: Sequence[PlanCrossing], apart_m: float, growing: bool = False) -> bool:
    """Whether strands come nearer than `apart_m` to one another only where they cross."""
    from scipy.spatial import KDTree

    string = np.repeat(np.arange(len(plan)), [len(curve) for curve in plan])
    s = np.concatenate([np.arange(len(curve)) * step_of(curve) for curve in plan])
    pairs = KDTree(np.vstack([curve[:, :2] for curve in plan])).query_pairs(apart_m, output_type="ndarray")
    i, j = pairs.min(axis=1), pairs.max(axis=1)
    # Along one strand, a chord of this length belongs to an arc of at most pi/2 times it.
    other = (string[i] != string[j]) | (s[j] - s[i] > apart_m * np.pi / 2)
    if growing:
        tip = (string == len(plan) - 1) & (s > s[-1] - _reach(apart_m, MIN_ANGLE_RAD))
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


def step_of(curve: np.ndarray) -> float:
    """Distance of the points of a curve in even steps."""
    return float(np.linalg.norm(curve[1] - curve[0]))


def _reach(apart_m: float, angle_rad: float) -> float:
    """How far from a crossing two strands may still be near one another, with room for their bending."""
    return 1.6 * apart_m / float(np.sin(angle_rad))
