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
            inner = min(int(np.searchsorted(arc_length(points), parameters.r_f)), len(points) - 1)
            offset = points[0] - points[inner]
            norm = float(np.linalg.norm(offset))
            ends.append(End(index, at_start, points[0], offset / norm if norm > 0 else np.zeros(3)))
    return ends


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
        bridges: (N, 3) points between the two ends of some pairs, from the first to the second end of the pair. Other
            pairs are joined by `bridge_gap`.

    Returns:
        The joined strands, in the order of their first members in `strands`.
    """
    partner = {a: b for pair in pairs for a, b in (pair, pair[::-1])}
    end_index = {(end.strand, end.at_start): number for number, end in enumerate(ends)}
    given: dict[tuple[int, int], Points] = {}
    for (a, b), points in (bridges or {}).items():
        given |= {(a, b): points, (b, a): points[::-1]}
    done: set[int] = set()
    joined = []

    def walk(strand: int, leave_at_start: bool) -> tuple[list[tuple[int, bool]], bool]:
        """Return the path from one end, as (strand, leaves at start) per strand, and whether the path is closed."""
        path = [(strand, leave_at_start)]
        while (following := partner.get(end_index.get((strand, leave_at_start), -1))) is not None:
            strand, leave_at_start = ends[following].strand, not ends[following].at_start
            if strand == path[0][0]:
                return path, True
            path.append((strand, leave_at_start))
        return path, False

    for first in range(len(strands)):
        if first in done:
            continue
        backwards, closed = walk(first, True)
        # Start from the far end, because the walk must pass every strand once.
        start, left_at_start = backwards[-1]
        path, closed = (backwards, True) if closed else walk(start, not left_at_start)
        done |= {strand for strand, _ in path}
        leaving = [end_index.get((i, reverse), -1) for i, reverse in path]
        between = [given.get((end, partner.get(end, -1))) for end in leaving]
        joined.append(_concatenate([(strands[i], reverse) for i, reverse in path], between, closed, parameters))
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


def _concatenate(
    path: list[tuple[Strand, bool]], bridges: list[Points | None], closed: bool, parameters: ChainParameters
) -> Strand:
    """Concatenate the strands of `path`, pairs (strand, is reversed), with a bridge in every gap.

    `bridges` are the given bridges after each strand, None for one that `bridge_gap` makes.
    """
    oriented = [Strand(s.points[::-1], s.bridged[::-1], s.closed) if reverse else s for s, reverse in path]
    if len(oriented) == 1 and not closed:
        return oriented[0]
    points, bridged = [oriented[0].points], [oriented[0].bridged]
    followers = oriented[1:] + oriented[:1] if closed else oriented[1:]
    for previous, following, given in zip(oriented, followers, bridges, strict=False):
        leaving = strand_ends([previous], parameters)[1]
        arriving = strand_ends([following], parameters)[0]
        bridge = bridge_gap(leaving, arriving, parameters.r_n) if given is None else given
        points.append(bridge)
        bridged.append(np.ones(len(bridge), dtype=bool))
        if following is not oriented[0]:
            points.append(following.points)
            bridged.append(following.bridged)
    return Strand(np.vstack(points), np.concatenate(bridged), closed)
