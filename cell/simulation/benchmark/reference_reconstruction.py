"""Reconstruct the strings from the segments in the literal baseline, by section III.E of the paper."""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters

Points = NDArray[np.float64]
End = tuple[int, int]
"""End of a segment, as the index of the segment, and 0 for its first point or -1 for its last point."""

DIRECTION_POINTS = 4
"""Number of points at an end of a segment that determine the direction of the end."""


def reconstruct(segments: Sequence[Points], centres: Points, parameters: ChainParameters) -> list[Points]:
    """Connect segments to strings.

    First, ends closer than `r_f` are connected (III.E.1). Then the ends around each bifurcation centre are connected
    (III.E.2).

    Args:
        segments: Points (N, 3) of each segment, metres.
        centres: Bifurcation centre points (M, 3), metres.
        parameters: Radii and thresholds of Table I.

    Returns:
        Ordered points (N, 3) of each string, metres.

    Source:
        Section III.E.
    """
    joints = _Joints(segments)
    free = joints.free_ends()
    pairs = sorted((float(np.linalg.norm(joints.point(a) - joints.point(b))), a, b) for a, b in combinations(free, 2))
    for apart, a, b in pairs:
        if apart < parameters.r_f:
            joints.connect(a, b)
    for centre in centres:
        # The ends of a bifurcation lie outside the inner sphere, and at most one link outside the outer sphere.
        around = sorted((float(np.linalg.norm(joints.point(end) - centre)), end) for end in joints.free_ends())
        ends = [end for apart, end in around if apart < parameters.r_cf + parameters.r_n]
        for a, b in _feasible_connection(ends[:4], joints):
            joints.connect(a, b)
    return joints.chains()


def _feasible_connection(ends: Sequence[End], joints: "_Joints") -> list[tuple[End, End]]:
    """Return the pairing of up to four ends with the smallest evaluation value b, eq. (8)."""
    if len(ends) == 4:
        a, b, c, d = ends
        pairings = [[(a, b), (c, d)], [(a, c), (b, d)], [(a, d), (b, c)]]
    else:
        pairings = [[pair] for pair in combinations(ends, 2)]
    if not pairings:
        return []
    return min(
        pairings,
        key=lambda pairing: sum(float(joints.direction(a) @ joints.direction(b)) for a, b in pairing),
    )


class _Joints:
    """Segments, and the connections between their ends."""

    def __init__(self, segments: Sequence[Points]) -> None:
        self.segments = segments
        self.partner: dict[End, End] = {}

    def ends(self) -> Iterator[End]:
        """Return both ends of every segment."""
        return ((k, side) for k in range(len(self.segments)) for side in (0, -1))

    def free_ends(self) -> list[End]:
        """Return the ends that have no partner."""
        return [end for end in self.ends() if end not in self.partner]

    def point(self, end: End) -> Points:
        """Return the point (3,) at an end."""
        return self.segments[end[0]][end[1]]

    def direction(self, end: End) -> Points:
        """Return v_i (3,), the outward unit vector of the segment at its end."""
        points = self.segments[end[0]][:: 1 if end[1] == 0 else -1][:DIRECTION_POINTS]
        return (points[0] - points[-1]) / np.linalg.norm(points[0] - points[-1])

    def connect(self, a: End, b: End) -> None:
        """Connect two ends, unless one of them is already connected or the connection would close a ring."""
        if a not in self.partner and b not in self.partner and self.walk(a)[-1] != b:
            self.partner[a], self.partner[b] = b, a

    def walk(self, end: End) -> list[End]:
        """Return all ends along a chain from one free end to the other, two for each segment."""
        passed = [end]
        while True:
            passed.append((passed[-1][0], -1 - passed[-1][1]))
            if passed[-1] not in self.partner:
                return passed
            passed.append(self.partner[passed[-1]])

    def chains(self) -> list[Points]:
        """Return the points (N, 3) of each chain of connected segments, from one free end to the other."""
        result = []
        for end in self.free_ends():
            walk = self.walk(end)
            # Each chain is walked from both of its free ends. Keep one of the two walks.
            if end > walk[-1]:
                result.append(np.vstack([self.segments[k][:: 1 if side == 0 else -1] for k, side in walk[::2]]))
        return result
