"""Strands and their ends, and how strands become one when ends are joined by a smooth bridge."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Strand:
    """A segment or several joined ones."""

    points: Points
    """(N, 3), in order."""
    bridged: NDArray[np.bool_]
    """(N,), points that were put into a gap rather than measured."""
    closed: bool = False
    """The ends were joined to each other."""


@dataclass(frozen=True, eq=False)
class End:
    """One end of a strand."""

    strand: int
    """Which strand."""
    at_start: bool
    """The strand's first point, otherwise its last."""
    point: Points
    """(3,)."""
    direction: Points
    """(3,), unit length, pointing out of the strand; zero for a strand of one point."""


def strand_ends(strands: Sequence[Strand], parameters: ChainParameters) -> list[End]:
    """Both ends of every open strand; their directions over about r_f, so that no single link decides."""
    ends = []
    for index, strand in enumerate(strands):
        if strand.closed:
            continue
        for at_start in (True, False):
            points = strand.points if at_start else strand.points[::-1]
            inner = min(int(np.searchsorted(arc_length(points), parameters.r_f)), len(points) - 1)
            way = points[0] - points[inner]
            norm = float(np.linalg.norm(way))
            ends.append(End(index, at_start, points[0], way / norm if norm > 0 else np.zeros(3)))
    return ends


def join(
    strands: Sequence[Strand],
    ends: Sequence[End],
    pairs: Sequence[tuple[int, int]],
    parameters: ChainParameters,
) -> list[Strand]:
    """The strands after joining the ends (indices) of each pair by a smooth bridge.

    Strands keep the order of their first member; a strand whose own ends are a pair becomes closed.
    """
    partner = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    end_at = {(end.strand, end.at_start): number for number, end in enumerate(ends)}
    done: set[int] = set()
    joined = []

    def walk(strand: int, leave_at_start: bool) -> tuple[list[tuple[int, bool]], bool]:
        """Strands from `strand` on, each with the side by which it is left; whether it came back to the first."""
        path = [(strand, leave_at_start)]
        while (following := partner.get(end_at.get((strand, leave_at_start), -1))) is not None:
            strand, leave_at_start = ends[following].strand, not ends[following].at_start
            if strand == path[0][0]:
                return path, True
            path.append((strand, leave_at_start))
        return path, False

    for first in range(len(strands)):
        if first in done:
            continue
        backwards, closed = walk(first, True)
        # Start from the far end, so that the walk passes the whole strand once.
        start, left_at_start = backwards[-1]
        path, closed = (backwards, True) if closed else walk(start, not left_at_start)
        done |= {strand for strand, _ in path}
        joined.append(_chain_up([(strands[i], reverse) for i, reverse in path], closed, parameters))
    return joined


def bridge(a: End, b: End, spacing: float) -> Points:
    """(N, 3) points between two ends, about `spacing` apart: the cubic that leaves and arrives in their directions.

    The paper links the ends by a straight line; a string does not bend in corners.
    """
    gap = float(np.linalg.norm(b.point - a.point))
    inner = max(round(gap / spacing), 1) - 1
    curve = CubicHermiteSpline([0, 1], [a.point, b.point], [a.direction * gap, -b.direction * gap])
    return curve(np.arange(1, inner + 1) / (inner + 1)).reshape(-1, 3)


def _chain_up(path: list[tuple[Strand, bool]], closed: bool, parameters: ChainParameters) -> Strand:
    oriented = [Strand(s.points[::-1], s.bridged[::-1], s.closed) if reverse else s for s, reverse in path]
    if len(oriented) == 1 and not closed:
        return oriented[0]
    points, bridged = [oriented[0].points], [oriented[0].bridged]
    followers = oriented[1:] + oriented[:1] if closed else oriented[1:]
    for previous, following in zip(oriented, followers, strict=False):
        leaving = strand_ends([previous], parameters)[1]
        arriving = strand_ends([following], parameters)[0]
        filled = bridge(leaving, arriving, parameters.r_n)
        points.append(filled)
        bridged.append(np.ones(len(filled), dtype=bool))
        if following is not oriented[0]:
            points.append(following.points)
            bridged.append(following.bridged)
    return Strand(np.vstack(points), np.concatenate(bridged), closed)
