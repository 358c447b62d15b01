"""Intersections of polylines, including self-intersections, in the projection onto the table."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, close_polyline

PARALLEL_SINE = 1e-6
"""Maximum sine of the angle between parallel links. The intersection of such links would depend on rounding."""
ROUNDING_SHARE = 1e-9
"""Margin at both ends of a link, as a share of the link length. Rounding may put an intersection beyond the end."""
SAME_POINT_M = 1e-6
"""Maximum distance along both strands between two detections of one intersection, metres. Neighbouring links can detect
the same intersection."""


class Polyline(Protocol):
    """Protocol of an object that can intersect others: a strand or a chain."""

    @property
    def points(self) -> NDArray[np.float64]:
        """(N, 3) points in order, metres."""
        ...

    @property
    def closed(self) -> bool:
        """True if the last point connects to the first."""
        ...


@dataclass(frozen=True, eq=False)
class Intersection:
    """Intersection of two strands in the projection onto the table."""

    strands: tuple[int, int]
    """Indices of the two strands. They are equal if a strand intersects itself."""
    s_m: tuple[float, float]
    """Arc length from the first point of each strand to the intersection, metres."""
    heights_m: tuple[float, float]
    """z of each strand at the intersection, metres, base frame."""
    directions: tuple[NDArray[np.float64], NDArray[np.float64]]
    """(2,) unit vector of each strand in the table plane."""
    xy: NDArray[np.float64]
    """(2,) position of the intersection in the table plane, metres, base frame."""


@dataclass(frozen=True, eq=False)
class _Links:
    """Links of all strands, strand by strand. A link connects two successive points."""

    start: NDArray[np.float64]
    """(N, 3) first point of each link, metres."""
    vector: NDArray[np.float64]
    """(N, 3) vector from the first to the second point of each link, metres."""
    s: NDArray[np.float64]
    """(N,) arc length of the strand at the first point of each link, metres."""
    strand: NDArray[np.intp]
    """(N,) index of the strand of each link."""
    number: NDArray[np.intp]
    """(N,) index of each link within its strand."""


def find_intersections(strands: Sequence[Polyline]) -> list[Intersection]:
    """Return the intersections of the strands, sorted by strand and then along the strand."""
    lines = [close_polyline(strand.points, strand.closed) for strand in strands]
    links = _collect_links(lines)
    m, n = _nearby_pairs(links)
    a, b = _shares_at_intersection(links, m, n)
    # A small margin beyond both ends of a link finds intersections that rounding puts between two links.
    is_hit = (np.abs(a - 0.5) <= 0.5 + ROUNDING_SHARE) & (np.abs(b - 0.5) <= 0.5 + ROUNDING_SHARE)
    closed = np.array([strand.closed for strand in strands], dtype=bool)
    is_hit &= ~_are_neighbours(links, m, n, closed)
    lengths = np.array([arc_length(line)[-1] for line in lines])
    periods = np.where(closed, lengths, np.inf).tolist()
    found: list[Intersection] = []
    for k in np.flatnonzero(is_hit):
        intersection = _intersect_links(links, int(m[k]), int(n[k]), float(a[k]), float(b[k]))
        if not any(_is_same(intersection, known, periods) for known in found):
            found.append(intersection)
    return found


def planar_cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cross products (...,) of the planar vectors `a` and `b` (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _collect_links(lines: Sequence[NDArray[np.float64]]) -> _Links:
    counts = [len(line) - 1 for line in lines]
    empty = np.empty((0, 3))
    return _Links(
        start=np.vstack([empty, *(line[:-1] for line in lines)]),
        vector=np.vstack([empty, *(np.diff(line, axis=0) for line in lines)]),
        s=np.concatenate([[], *(arc_length(line)[:-1] for line in lines)]),
        strand=np.repeat(np.arange(len(lines)), counts),
        number=np.concatenate([np.empty(0, dtype=np.intp), *(np.arange(count) for count in counts)]),
    )


def _nearby_pairs(links: _Links) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices (P,) and (P,) of the pairs of links that may intersect, sorted by strand, then along it."""
    if len(links.start) == 0:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    middle = links.start[:, :2] + links.vector[:, :2] / 2
    max_length = float(np.linalg.norm(links.vector[:, :2], axis=1).max())
    # The distance between the middles of two intersecting links is at most half the sum of their lengths.
    m, n = np.sort(KDTree(middle).query_pairs(max_length * (1 + 2 * ROUNDING_SHARE), output_type="ndarray"), axis=1).T
    order = np.lexsort((n, m, links.strand[n], links.strand[m]))
    return m[order], n[order]


def _shares_at_intersection(
    links: _Links, m: NDArray[np.intp], n: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the shares (P,) of links m and (P,) of links n that lie before their intersection; NaN if parallel."""
    u = links.vector[m, :2]
    v = links.vector[n, :2]
    offset = links.start[n, :2] - links.start[m, :2]
    determinant = planar_cross(u, v)
    is_parallel = np.abs(determinant) <= PARALLEL_SINE * np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    determinant = np.where(is_parallel, np.nan, determinant)
    return planar_cross(offset, v) / determinant, planar_cross(offset, u) / determinant


def _are_neighbours(
    links: _Links, m: NDArray[np.intp], n: NDArray[np.intp], closed: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which links (P,) m and n share a point. `closed` (S,) states which strands are closed."""
    strand = links.strand[m]
    distance = links.number[n] - links.number[m]
    # In a closed strand, the last link is next to the first.
    last_number = np.bincount(links.strand, minlength=len(closed)) - 1
    is_next = (distance == 1) | (closed[strand] & (distance == last_number[strand]))
    return is_next & (strand == links.strand[n])


def _intersect_links(links: _Links, m: int, n: int, a: float, b: float) -> Intersection:
    """Return the intersection of links m and n. It lies at the share a of link m and at the share b of link n."""
    point_m = links.start[m] + a * links.vector[m]
    point_n = links.start[n] + b * links.vector[n]
    s_m = links.s[m] + a * np.linalg.norm(links.vector[m])
    s_n = links.s[n] + b * np.linalg.norm(links.vector[n])
    return Intersection(
        strands=(int(links.strand[m]), int(links.strand[n])),
        s_m=(float(s_m), float(s_n)),
        heights_m=(float(point_m[2]), float(point_n[2])),
        directions=(_planar_direction(links.vector[m]), _planar_direction(links.vector[n])),
        xy=point_m[:2],
    )


def _planar_direction(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit vector (2,) of a vector (3,) in the table plane."""
    return vector[:2] / np.linalg.norm(vector[:2])


def _is_same(one: Intersection, other: Intersection, periods: Sequence[float]) -> bool:
    """Return whether two intersections are equal. `periods` has the strand lengths, infinite for an open strand."""
    if one.strands != other.strands:
        return False
    strand_periods = [periods[strand] for strand in one.strands]
    if _are_close(one.s_m, other.s_m, strand_periods):
        return True
    # A strand passes a self-intersection twice. In a closed strand, either pass may be the first.
    is_self_intersection = one.strands[0] == one.strands[1]
    return is_self_intersection and _are_close(one.s_m, other.s_m[::-1], strand_periods)


def _are_close(one_s_m: Sequence[float], other_s_m: Sequence[float], periods: Sequence[float]) -> bool:
    """Return whether two intersections are near each other along both strands."""
    for one, other, period in zip(one_s_m, other_s_m, periods, strict=True):
        distance = abs(one - other)
        if min(distance, period - distance) > SAME_POINT_M:
            return False
    return True
