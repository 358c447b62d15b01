"""Reconstruction of the point chain model by the literal baseline, section III.E of the paper."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

Points = NDArray[np.float64]
End = tuple[int, int]
"""Index of a segment, and 0 for its first point or -1 for its last."""

DIRECTION_POINTS = 4
"""Number of points at the end of a segment that give its direction."""


def reconstruct(segments: Sequence[Points], centres: Points, parameters: ChainParameters) -> list[Points]:
    """Connect segments to strings: close ends (III.E.1), then at each bifurcation centre (III.E.2).

    Args:
        segments: Points (N, 3) of each segment.
        centres: Bifurcation centre points (M, 3).
        parameters: Parameters of the paper.
    """
    joints = _Joints(segments)
    free = joints.free_ends()
    pairs = sorted((float(np.linalg.norm(joints.point(a) - joints.point(b))), a, b) for a, b in combinations(free, 2))
    for apart, a, b in pairs:
        if apart < parameters.r_f:
            joints.connect(a, b)
    for centre in centres:
        # segments end outside the inner sphere, within a link of the outer one
        around = sorted((float(np.linalg.norm(joints.point(end) - centre)), end) for end in joints.free_ends())
        ends = [end for apart, end in around if apart < parameters.r_cf + parameters.r_n]
        for a, b in _feasible_connection(ends[:4], joints):
            joints.connect(a, b)
    return joints.chains()


def _feasible_connection(ends: Sequence[End], joints: "_Joints") -> list[tuple[End, End]]:
    """Return the pairs of up to four ends with the smallest evaluation value b, eq. (8)."""
    if len(ends) == 4:
        a, b, c, d = ends
        choices = [[(a, b), (c, d)], [(a, c), (b, d)], [(a, d), (b, c)]]
    else:
        choices = [[couple] for couple in combinations(ends, 2)]
    if not choices:
        return []
    return min(choices, key=lambda choice: sum(float(joints.direction(a) @ joints.direction(b)) for a, b in choice))


class _Joints:
    """Connections between ends of segments."""

    def __init__(self, segments: Sequence[Points]) -> None:
        self.segments = segments
        self.partner: dict[End, End] = {}

    def ends(self) -> Iterator[End]:
        return ((k, side) for k in range(len(self.segments)) for side in (0, -1))

    def free_ends(self) -> list[End]:
        return [end for end in self.ends() if end not in self.partner]

    def point(self, end: End) -> Points:
        return self.segments[end[0]][end[1]]

    def direction(self, end: End) -> Points:
        """Return v_i, the unit vector out of the segment at its end."""
        points = self.segments[end[0]][:: 1 if end[1] == 0 else -1][:DIRECTION_POINTS]
        return (points[0] - points[-1]) / np.linalg.norm(points[0] - points[-1])

    def connect(self, a: End, b: End) -> None:
        """Connect two free ends, unless that would close a ring."""
        if a not in self.partner and b not in self.partner and self.walk(a)[-1] != b:
            self.partner[a], self.partner[b] = b, a

    def walk(self, end: End) -> list[End]:
        """Return the ends from a free end to the other free end of the chain, two for each segment."""
        passed = [end]
        while True:
            passed.append((passed[-1][0], -1 - passed[-1][1]))
            if passed[-1] not in self.partner:
                return passed
            passed.append(self.partner[passed[-1]])

    def chains(self) -> list[Points]:
        """Return the points of the connected segments, from one free end to the other."""
        result = []
        for end in self.free_ends():
            walk = self.walk(end)
            # each chain is found from both of its ends
            if end > walk[-1]:
                result.append(np.vstack([self.segments[k][:: 1 if side == 0 else -1] for k, side in walk[::2]]))
        return result
