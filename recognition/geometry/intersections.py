"""Where strands cross one another, or themselves, as seen from above."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline

PARALLEL = 1e-6
"""Sine of the angle under which links count as parallel: where such meet is rounding."""
ROUNDING = 1e-9
"""Share of a link within which rounding may put a crossing beyond its end."""
SAME_PLACE_M = 1e-6
"""Crossings closer than this along both strands are one, found in two links."""


class Line(Protocol):
    """What can cross: strands and chains."""

    @property
    def points(self) -> NDArray[np.float64]: ...
    @property
    def closed(self) -> bool: ...


@dataclass(frozen=True, eq=False)
class Intersection:
    """Two strands crossing in the projection onto the table."""

    strands: tuple[int, int]
    """Indices; the same twice for a strand that crosses itself."""
    s_m: tuple[float, float]
    """Arc length along each."""
    heights_m: tuple[float, float]
    """z of each polyline there."""
    directions: tuple[NDArray[np.float64], NDArray[np.float64]]
    """(2,) unit vectors of each in the table plane."""
    xy: NDArray[np.float64]
    """(2,)."""


@dataclass(frozen=True, eq=False)
class _Links:
    """All links of all strands, one strand after the other."""

    start: NDArray[np.float64]
    """(N, 3)"""
    way: NDArray[np.float64]
    """(N, 3) to its end."""
    s: NDArray[np.float64]
    """(N,) arc length at its start."""
    strand: NDArray[np.intp]
    """(N,)"""
    number: NDArray[np.intp]
    """(N,) within its strand."""


def find_intersections(strands: Sequence[Line]) -> list[Intersection]:
    """Where the strands cross, in the order of the strands and along them."""
    lines = [close_polyline(strand.points, strand.closed) for strand in strands]
    links = _links(lines)
    m, n = _near(links)
    u, v, w = links.way[m, :2], links.way[n, :2], links.start[n, :2] - links.start[m, :2]
    determinant = _cross(u, v)
    parallel = np.abs(determinant) <= PARALLEL * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = _cross(w, v) / determinant, _cross(w, u) / determinant
        # A little beyond the links' ends, so that no crossing in a point of the chain falls between two of them.
        hit = ~parallel & (np.abs(a - 0.5) <= 0.5 + ROUNDING) & (np.abs(b - 0.5) <= 0.5 + ROUNDING)
    count = np.bincount(links.strand, minlength=len(lines))
    closed = np.array([strand.closed for strand in strands], dtype=bool)
    of = links.strand[m]
    apart = links.number[n] - links.number[m]
    # Neighbouring links share a point and do not cross; in a closed strand also the last and the first.
    neighbours = (apart == 1) | (closed[of] & (apart == count[of] - 1))
    hit &= (of != links.strand[n]) | ~neighbours
    round_ = [
        float(arc_length(line)[-1]) if strand.closed else np.inf for line, strand in zip(lines, strands, strict=True)
    ]
    found: list[Intersection] = []
    for k in np.flatnonzero(hit):
        meeting = _meeting(links, int(m[k]), int(n[k]), float(a[k]), float(b[k]))
        if not any(_same(meeting, known, round_) for known in found):
            found.append(meeting)
    return found


def _links(lines: Sequence[NDArray[np.float64]]) -> _Links:
    counts = [len(line) - 1 for line in lines]
    nothing = np.empty((0, 3))
    return _Links(
        start=np.vstack([nothing, *(line[:-1] for line in lines)]),
        way=np.vstack([nothing, *(np.diff(line, axis=0) for line in lines)]),
        s=np.concatenate([[], *(arc_length(line)[:-1] for line in lines)]),
        strand=np.repeat(np.arange(len(lines)), counts),
        number=np.concatenate([np.empty(0, dtype=np.intp), *(np.arange(count) for count in counts)]),
    )


def _near(links: _Links) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(P,) and (P,) couples of links that are near enough to cross, in the order of the strands and along them."""
    if len(links.start) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    middle = links.start[:, :2] + links.way[:, :2] / 2
    longest = float(np.linalg.norm(links.way[:, :2], axis=1).max())
    # Links that cross have their middles no farther apart than half of both.
    m, n = np.sort(KDTree(middle).query_pairs(longest * (1 + 2 * ROUNDING), output_type="ndarray"), axis=1).T
    order = np.lexsort((n, m, links.strand[n], links.strand[m]))
    return m[order], n[order]


def _meeting(links: _Links, m: int, n: int, a: float, b: float) -> Intersection:
    """Where link m, at the share a of its length, crosses link n at b."""
    places = [links.start[k] + share * links.way[k] for k, share in ((m, a), (n, b))]
    first, second = (links.way[k, :2] / np.linalg.norm(links.way[k, :2]) for k in (m, n))
    along = [float(links.s[k] + share * np.linalg.norm(links.way[k])) for k, share in ((m, a), (n, b))]
    return Intersection(
        strands=(int(links.strand[m]), int(links.strand[n])),
        s_m=(along[0], along[1]),
        heights_m=(float(places[0][2]), float(places[1][2])),
        directions=(first, second),
        xy=places[0][:2],
    )


def _same(one: Intersection, other: Intersection, round_: Sequence[float]) -> bool:
    """Whether both are the same place of the same strands, of which the closed ones are `round_` long."""
    if one.strands != other.strands:
        return False
    # A strand that crosses itself passes the place twice, in either order if it is closed.
    orders = ((0, 1), (1, 0)) if one.strands[0] == one.strands[1] else ((0, 1),)
    ways = [[abs(one.s_m[k] - other.s_m[order[k]]) for k in (0, 1)] for order in orders]
    return any(
        all(min(way, round_[strand] - way) <= SAME_PLACE_M for way, strand in zip(pair, one.strands, strict=True))
        for pair in ways
    )


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(P,) of plane vectors (P, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
