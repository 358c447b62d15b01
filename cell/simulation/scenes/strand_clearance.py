"""When strands on the table keep apart well enough to be told from one another."""

from collections.abc import Sequence

import numpy as np

from cell.simulation.scenes.planar_crossings import Curves, PlanCrossing, is_closed, near_pairs

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
    plan: Curves,
    crossings: Sequence[PlanCrossing],
    radius_m: float,
    clearance: float,
    growing: bool = False,
    min_angle_rad: float = MIN_ANGLE_RAD,
    since: int = 0,
) -> bool:
    """Whether crossings are steep enough, away from ends and from one another, and other strands apart.

    Apart is `clearance` radii. `plan` holds the strings' courses (N, 2) in even steps, `crossings` all their
    crossings. With `growing` the end of the last string is not its end yet: it may be near to another strand that
    it is about to cross. With `since`, strands that lay there before that point of the last string are known to be
    apart.
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
    """Whether strands come nearer than `apart_m` to one another only where they cross."""
    string = np.repeat(np.arange(len(plan)), [len(curve) for curve in plan])
    s = np.concatenate([np.arange(len(curve)) * step_of(curve) for curve in plan])
    tip_m = _reach(apart_m, min_angle_rad)
    if since:
        # What lay behind the former tip has been looked at; the tip itself was left out then.
        since = len(s) - len(plan[-1]) + max(since - 2 - int(tip_m / step_of(plan[-1])), 0)
    i, j = near_pairs(np.vstack([curve[:, :2] for curve in plan]), apart_m, since)
    # Along one strand, a chord of this length belongs to an arc of at most pi/2 times it.
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
    """How far two strands at most stand in one another, as a share of the sum of their radii; negative: apart.

    `curves` are centre lines (N, 3) in even steps. Infinitely negative when no two strands come near. An end's last
    radius does not count: strings end square, and an end may butt against a strand's side.
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
    # In a string's tightest bends its own points are as near as this.
    other = (string[i] != string[j]) | (np.minimum(along, whole[string[i]] - along) > 1.2 * np.pi * radius[i])
    other &= (to_end[i] > radius[i]) & (to_end[j] > radius[j])
    i, j = i[other], j[other]
    thick = radius[i] + radius[j]
    return float((1 - np.linalg.norm(points[i] - points[j], axis=1) / thick).max(initial=-np.inf))


def step_of(curve: np.ndarray) -> float:
    """Distance of the points of a curve in even steps."""
    return float(np.linalg.norm(curve[1] - curve[0]))


def _reach(apart_m: float, angle_rad: float) -> float:
    """How far from a crossing two strands may still be near one another, with room for their bending."""
    return 1.6 * apart_m / float(np.sin(angle_rad))
