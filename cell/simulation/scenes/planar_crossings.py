"""Crossings of curves on the table, seen from above."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Curves = Sequence[NDArray[np.float64]]

_SAME = 1e-9
"""Largest difference of equal positions, in points."""


@dataclass(frozen=True)
class PlanCrossing:
    """Two strands that cross in the xy plane. `first` comes before `second` by string, then by position."""

    first: tuple[int, float]
    """String and position on it in units of its points. 12.25 is a quarter of the way from point 12 to 13."""
    second: tuple[int, float]
    point: tuple[float, float]
    """Position (x, y), metres."""
    angle_rad: float
    """Angle between the strands, 0 to pi/2."""


def plan_crossings(curves: Curves, since: int = 0) -> tuple[PlanCrossing, ...]:
    """Return all crossings of polylines with themselves and with each other, ordered by `first`.

    Segments with a common point do not cross, nor do the first and the last segment of a closed curve.

    Args:
        curves: Polylines, (N, 2) or (N, 3) each. z is ignored.
        since: Only crossings with a point of the last curve from this index on are returned.
    """
    if not curves:
        return ()
    string, index = _numbering(curves)
    start = np.vstack([curve[:-1, :2] for curve in curves])
    along = np.vstack([np.diff(curve[:, :2], axis=0) for curve in curves])
    # the middles of two intersecting segments are no farther apart than half the sum of their lengths
    longest = float(np.linalg.norm(along, axis=1).max())
    middles = start + along / 2
    first_new = len(middles) - len(curves[-1]) + 1 + max(since - 1, 0) if since else 0
    i, j = near_pairs(middles, longest * 1.001, first_new)
    apart = (string[i] != string[j]) | ((j - i > 1) & ~_joined(curves, string[i], index[i], index[j]))
    i, j = i[apart], j[apart]
    a, b, between = along[i], along[j], start[j] - start[i]
    denominator = _cross(a, b)
    with np.errstate(divide="ignore", invalid="ignore"):
        t, u = _cross(between, b) / denominator, _cross(between, a) / denominator
        # slightly beyond the ends, because a crossing at a point of both curves could be missed
        meet = (denominator != 0) & (np.abs(t - 0.5) <= 0.5 + _SAME) & (np.abs(u - 0.5) <= 0.5 + _SAME)
    order = np.nonzero(meet)[0][np.lexsort((j[meet], i[meet]))]
    result: list[PlanCrossing] = []
    for k in order:
        m, n = i[k], j[k]
        cosine = abs(a[k] @ b[k]) / (np.linalg.norm(a[k]) * np.linalg.norm(b[k]))
        point = start[m] + t[k] * a[k]
        crossing = PlanCrossing(
            first=(int(string[m]), float(index[m] + t[k])),
            second=(int(string[n]), float(index[n] + u[k])),
            point=(float(point[0]), float(point[1])),
            angle_rad=float(np.arccos(min(cosine, 1.0))),
        )
        if not any(_same(crossing, other) for other in result):
            result.append(crossing)
    return tuple(result)


def near_pairs(
    points: NDArray[np.float64], within_m: float, since: int = 0
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs i < j of points (N, 2) within a distance, and with `since` only those with j >= since."""
    from scipy.spatial import KDTree

    # for a few new points, most other points are far away
    low, high = points[since:].min(axis=0) - within_m, points[since:].max(axis=0) + within_m
    around = np.nonzero(((points >= low) & (points <= high)).all(axis=1))[0]
    pairs = np.sort(around[KDTree(points[around]).query_pairs(within_m, output_type="ndarray")], axis=1)
    pairs = pairs[pairs[:, 1] >= since]
    return pairs[:, 0], pairs[:, 1]


def is_closed(curve: NDArray[np.float64]) -> bool:
    """Return whether the last point of the polyline `curve` (N, d) is its first."""
    return len(curve) > 3 and bool((curve[0] == curve[-1]).all())


def _joined(curves: Curves, string: NDArray[np.int64], i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether segments i < j of a string are the first and the last of a closed curve."""
    last = np.array([len(curve) - 2 if is_closed(curve) else -1 for curve in curves])
    return (i == 0) & (j == last[string])


def _same(a: PlanCrossing, b: PlanCrossing) -> bool:
    """Return whether two crossings are the same one, found by two neighbouring segments."""
    return all(s == t and abs(x - y) < 4 * _SAME for (s, x), (t, y) in ((a.first, b.first), (a.second, b.second)))


def at(curve: NDArray[np.float64], position: float) -> NDArray[np.float64]:
    """Return the point of the polyline `curve` (N, d) at a position in units of its points."""
    k = min(int(position), len(curve) - 2)
    return curve[k] + (position - k) * (curve[k + 1] - curve[k])


def _numbering(curves: Curves) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return string and index within it of each segment of all curves."""
    counts = [len(curve) - 1 for curve in curves]
    return np.repeat(np.arange(len(curves)), counts), np.concatenate([np.arange(n) for n in counts])


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
