"""Canonical direction, first point and order of chains, so that an unmoved scene gives the same model at each scan.

The rules depend on the positions of whole lines, because single points, for example the ends, have larger errors. All
rules use the coordinate `x + y / 2` of the base frame. It is oblique, because people often lay strings along x or y,
and a rule along x or y would then depend on noise.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length, close_polyline

ORDER_AXIS = np.array([1.0, 0.5, 0.0]) / np.hypot(1.0, 0.5)
"""Direction along which chains run and are ordered, unit vector, base frame."""
SIDE_AXIS = np.array([-0.5, 1.0, 0.0]) / np.hypot(1.0, 0.5)
"""Direction to the left of `ORDER_AXIS`, unit vector, base frame. It gives the direction of closed chains."""


@dataclass(frozen=True, eq=False)
class CanonicalLine:
    """Points of a chain in canonical order."""

    points: NDArray[np.float64]
    """(N, 3) points, metres. On an open chain, these are the given points."""
    source: NDArray[np.intp]
    """(N,) index of the given point from which each point takes its other values."""


def canonical_line(points: NDArray[np.float64], closed: bool) -> CanonicalLine:
    """Bring the points of a chain into canonical order.

    An open chain runs along increasing `x + y / 2`: its second half lies farther along `ORDER_AXIS` than its first
    half. The comparison weights each point with its arc length from the middle of the chain.

    A closed chain begins where the ray from its centroid against `ORDER_AXIS` leaves it. The point there replaces the
    nearer of its two neighbours. The chain then runs so that its second half lies farther along `SIDE_AXIS`:
    counter-clockwise, seen from above, if it has no crossing.

    Args:
        points: (N, 3) points of the chain, metres, base frame.
        closed: Whether the last point connects to the first.
    """
    if not closed:
        order = np.arange(len(points))
        is_forward = _moment(points) @ ORDER_AXIS >= 0
        order = order if is_forward else order[::-1]
        return CanonicalLine(points[order], order)
    line = _begin_on_ray(points)
    if _moment(close_polyline(line.points, closed=True)) @ SIDE_AXIS >= 0:
        return line
    backwards = np.append(0, np.arange(len(line.points) - 1, 0, -1))
    return CanonicalLine(line.points[backwards], line.source[backwards])


def order_key(points: NDArray[np.float64], closed: bool) -> float:
    """Return the value by which chains are ordered: the mean of the line along `ORDER_AXIS`, metres.

    Args:
        points: (N, 3) points of the chain, metres, base frame.
        closed: Whether the last point connects to the first.
    """
    return float(_mean(close_polyline(points, closed)) @ ORDER_AXIS)


def _begin_on_ray(points: NDArray[np.float64]) -> CanonicalLine:
    """Return a closed line that begins where the ray from its centroid against `ORDER_AXIS` leaves it."""
    count = len(points)
    offset = points - _mean(close_polyline(points, closed=True))
    along = offset @ ORDER_AXIS
    side = offset @ SIDE_AXIS
    following = np.roll(side, -1)
    share = side / np.where(side == following, 1.0, side - following)
    crosses = (side >= 0) != (following >= 0)
    position = along + share * (np.roll(along, -1) - along)
    if not (crosses & (position < 0)).any():
        # The line has no extent across the ray.
        return CanonicalLine(points, np.arange(count))
    before = int(np.where(crosses, position, np.inf).argmin())
    after = (before + 1) % count
    replaced = after if share[before] > 0.5 else before
    order = (replaced + np.arange(count)) % count
    moved = points[order]
    moved[0] = points[before] + share[before] * (points[after] - points[before])
    return CanonicalLine(moved, order)


def _moment(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean (3,) of the points of a polyline, weighted with the arc length from its middle, metres."""
    s = arc_length(line)
    length = np.diff(s)
    middle = (line[1:] + line[:-1]) / 2
    weight = ((s[1:] + s[:-1]) / 2 / max(s[-1], 1e-12) - 0.5) * length
    return weight @ middle / max(s[-1], 1e-12)


def _mean(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean (3,) of a polyline over its arc length, metres."""
    length = np.linalg.norm(np.diff(line, axis=0), axis=1)
    if length.sum() == 0:
        return line.mean(axis=0)
    return length @ ((line[1:] + line[:-1]) / 2) / length.sum()
