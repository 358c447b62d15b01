"""Strands and their ends. Strands are joined by smooth bridges across the gaps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Strand:
    """A segment of a string, or several joined segments."""

    points: Points
    """(N, 3) points in order, metres, base frame."""
    bridged: NDArray[np.bool_]
    """(N,) mask, True for points that were interpolated across a gap, not measured."""
    closed: bool = False
    """True if the last point connects to the first."""


@dataclass(frozen=True, eq=False)
class End:
    """One end of a strand."""

    strand: int
    """Index of the strand."""
    at_start: bool
    """True if the end is the first point of the strand, False if it is the last point."""
    point: Points
    """(3,) position of the end, metres, base frame."""
    direction: Points
    """(3,) unit vector pointing out of the strand; zero for a strand of one point."""


@dataclass(frozen=True)
class _Leg:
    """One strand of a path of joined strands, and the direction in which the path passes it."""

    strand: int
    """Index of the strand."""
    is_reversed: bool
    """True if the path passes the strand from the last to the first point."""

    @staticmethod
    def leaving_at(end: End) -> "_Leg":
        """Return the leg that leaves its strand at `end`."""
        return _Leg(end.strand, is_reversed=end.at_start)

    def reverse(self) -> "_Leg":
        """Return the leg in the other direction."""
        return _Leg(self.strand, not self.is_reversed)


def strand_ends(strands: Sequence[Strand], parameters: ChainParameters) -> list[End]:
    """Return both ends of every open strand, first point before last point.

    The direction of an end is measured over a length of about r_f. It does not depend on a single link.
    """
    ends = []
    for index, strand in enumerate(strands):
        if strand.closed:
            continue
        for at_start in (True, False):
            points = strand.points if at_start else strand.points[::-1]
            ends.append(End(index, at_start, points[0], _outward_direction(points, parameters.r_f)))
    return ends


def _outward_direction(points: Points, length: float) -> Points:
    """Return the unit vector (3,) out of a line at its first point, over a length; zero for coinciding points."""
    inner = min(int(np.searchsorted(arc_length(points), length)), len(points) - 1)
    offset = points[0] - points[inner]
    norm = float(np.linalg.norm(offset))
    if norm > 0:
        return offset / norm
    return np.zeros(3)


def join_strands(
    strands: Sequence[Strand],
    ends: Sequence[End],
    pairs: Sequence[tuple[int, int]],
    parameters: ChainParameters,
    bridges: Mapping[tuple[int, int], Points] | None = None,
) -> list[Strand]:
    """Join strands by smooth bridges at pairs of ends.

    Args:
        strands: The strands.
        ends: Ends of the strands, from `strand_ends`.
        pairs: Pairs of indices into `ends`. Each end is in at most one pair. A pair of both ends of one strand closes
            the strand.
        parameters: Method parameters; uses the bridge spacing r_n and the end length r_f.
        bridges: (N, 3) points between the two ends of some of `pairs`, from the first to the second end of the pair.
            Other pairs are joined by `bridge_gap`.

    Returns:
        The joined strands, in the order of their first members in `strands`.
    """
    # A pair is passed in both directions.
    following: dict[_Leg, _Leg] = {}
    given: dict[_Leg, Points] = {}
    for a, b in pairs:
        leg_a = _Leg.leaving_at(ends[a])
        leg_b = _Leg.leaving_at(ends[b])
        following[leg_a] = leg_b.reverse()
        following[leg_b] = leg_a.reverse()
        if bridges and (a, b) in bridges:
            given[leg_a] = bridges[a, b]
            given[leg_b] = bridges[a, b][::-1]

    done: set[int] = set()
    joined = []
    for first in range(len(strands)):
        if first in done:
            continue
        path, closed = _walk(_Leg(first, is_reversed=True), following)
        if not closed:
            # Start again from the far end, because the path must pass every strand once.
            path, closed = _walk(path[-1].reverse(), following)
        done.update(leg.strand for leg in path)
        oriented = [_orient(strands[leg.strand], leg.is_reversed) for leg in path]
        joined.append(_concatenate(oriented, [given.get(leg) for leg in path], closed, parameters))
    return joined


def bridge_gap(a: End, b: End, spacing: float) -> Points:
    """Return points between two ends, on a cubic curve with the directions of the ends.

    The paper connects the ends by a straight line, but a string has no corners.

    Args:
        a: End where the bridge begins.
        b: End where the bridge stops.
        spacing: Approximate distance of the points, metres.

    Returns:
        Points (N, 3) of the bridge, metres, without the two ends.

    Source:
        Section III.E. The cubic curve is not in the paper.
    """
    gap = float(np.linalg.norm(b.point - a.point))
    inner = max(round(gap / spacing), 1) - 1
    curve = CubicHermiteSpline([0, 1], [a.point, b.point], [a.direction * gap, -b.direction * gap])
    return curve(np.arange(1, inner + 1) / (inner + 1)).reshape(-1, 3)


def _walk(first: _Leg, following: Mapping[_Leg, _Leg]) -> tuple[list[_Leg], bool]:
    """Return the path that begins with a leg, and whether it leads back to the strand of this leg."""
    path = [first]
    while path[-1] in following:
        leg = following[path[-1]]
        if leg.strand == first.strand:
            return path, True
        path.append(leg)
    return path, False


def _orient(strand: Strand, is_reversed: bool) -> Strand:
    if not is_reversed:
        return strand
    return Strand(strand.points[::-1], strand.bridged[::-1], strand.closed)


def _bridge_between(previous: Strand, following: Strand, parameters: ChainParameters) -> Points:
    """Return the bridge (N, 3) from the last point of a strand to the first point of the following one."""
    _, leaving = strand_ends([previous], parameters)
    arriving, _ = strand_ends([following], parameters)
    return bridge_gap(leaving, arriving, parameters.r_n)


def _concatenate(
    strands: list[Strand], bridges: list[Points | None], closed: bool, parameters: ChainParameters
) -> Strand:
    """Concatenate strands in order, with a bridge in every gap.

    `bridges` are the given bridges after each strand, None for one that `bridge_gap` makes.
    """
    first = strands[0]
    if len(strands) == 1 and not closed:
        return first
    followers = strands[1:]
    if closed:
        followers.append(first)
    points = [first.points]
    bridged = [first.bridged]
    # The last strand of an open path has no follower.
    for previous, following, given in zip(strands, followers, bridges, strict=False):
        bridge = _bridge_between(previous, following, parameters) if given is None else given
        points.append(bridge)
        bridged.append(np.ones(len(bridge), dtype=bool))
        if following is not first:
            points.append(following.points)
            bridged.append(following.bridged)
    return Strand(np.vstack(points), np.concatenate(bridged), closed)
