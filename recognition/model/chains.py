"""Chains, positions on chains, and crossings. Metres and radians, base frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length

End = Literal["free", "unobserved", "touching"]
"""Kind of an end of a chain.

`free`: the end of the string was observed. `unobserved`: the end is hidden or outside the workspace, and the string may
continue there. `touching`: the end faces another end, and one string may continue there. Or the end meets the side of a
strand, and may be joined to it.
"""
MIN_CERTAIN_CONFIDENCE = 0.9
"""Minimum confidence of a certain crossing. With less confidence, either strand may be the upper strand."""


@dataclass(frozen=True, eq=False)
class WrittenLengths:
    """Arc lengths of a chain as a document states them. Those of its rounded points differ in the last digits."""

    arc_length_m: NDArray[np.float64]
    """(N,) arc length from the first point to each point, metres."""
    length_m: float
    """Length of the chain, metres."""


@dataclass(frozen=True, eq=False)
class Chain:
    """One string as ordered points of its centre line."""

    id: int
    """Number of the chain in the model, from 0."""
    closed: bool
    """Whether the last point connects to the first."""
    radius_m: float
    """Radius of the string, metres."""
    points: NDArray[np.float64]
    """(N, 3) points of the centre line, metres, base frame, in order from one end to the other."""
    sigma_m: NDArray[np.float64]
    """(N,) standard deviation of the position of each point across the string, metres."""
    views: NDArray[np.int64]
    """(N,) number of views that saw the string at each point; 0 where no view did, for example under a crossing."""
    ends: tuple[End, End]
    """Kinds of the first and the last end."""
    written_lengths: WrittenLengths | None = None
    """Arc lengths of the document from which the chain was read. None means that they follow from `points`."""

    @property
    def arc_length_m(self) -> NDArray[np.float64]:
        """(N,) arc length from the first point to each point, metres."""
        return arc_length(self.points) if self.written_lengths is None else self.written_lengths.arc_length_m

    @property
    def length_m(self) -> float:
        """Length of the chain, metres. For a closed chain, this includes the link from the last point to the first."""
        if self.written_lengths is not None:
            return self.written_lengths.length_m
        gap = float(np.linalg.norm(self.points[0] - self.points[-1])) if self.closed else 0.0
        return float(self.arc_length_m[-1]) + gap


@dataclass(frozen=True)
class StrandPoint:
    """A position on a chain."""

    chain: int
    """Id of the chain."""
    s_m: float
    """Arc length along the chain, metres."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """Crossing of two strands, which may belong to the same chain."""

    id: int
    """Number of the crossing in the model, from 0."""
    point: NDArray[np.float64]
    """(3,) midpoint of the two centre lines at the crossing, metres, base frame."""
    over: StrandPoint
    """Position of the crossing on the upper strand."""
    under: StrandPoint
    """Position of the crossing on the lower strand."""
    gap_m: float
    """Measured height of the upper centre line above the lower centre line, metres."""
    angle_rad: float
    """Angle between the strands, seen from above, 0 to pi/2 radians."""
    sign: int
    """Crossing sign for the directions of the chains, +1 (right-handed) or -1 (left-handed)."""
    confidence: float
    """Probability that `over` and `under` are assigned correctly, 0.5 to 1."""


@dataclass(frozen=True, eq=False)
class ChainInterpolator:
    """Linear interpolation of per-point values along a chain. On a closed chain, arc lengths may exceed one turn."""

    chain: Chain
    """Chain along which the values are interpolated."""

    @cached_property
    def _s(self) -> NDArray[np.float64]:
        s = self.chain.arc_length_m
        if not self.chain.closed:
            return s
        length = self.chain.length_m
        return np.concatenate([s - length, s, s + length, [2 * length]])

    def __call__(self, s: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Interpolate `values` at the arc lengths `s`.

        Args:
            s: Arc lengths along the chain, metres, array of any shape. The range is -L to 2 L on a closed chain of
                length L. On an open chain, arc lengths beyond an end give the value at the end.
            values: (N,) or (N, 3) values at the points of the chain.

        Returns:
            Interpolated values with the shape of `s`, plus a last axis of 3 if `values` is (N, 3).
        """
        if self.chain.closed:
            values = np.concatenate([values, values, values, values[:1]])
        if values.ndim == 1:
            return np.interp(s, self._s, values)
        return np.stack([np.interp(s, self._s, values[:, k]) for k in range(values.shape[1])], axis=-1)

    def distance(self, s: NDArray[np.float64], t: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the distances along the chain between the arc lengths `s` and `t`, metres.

        On a closed chain, the distance is measured in the shorter direction.
        """
        distance = np.abs(s - t)
        return np.minimum(distance, self.chain.length_m - distance) if self.chain.closed else distance

    def nearest_distance(self, s: NDArray[np.float64], positions: Sequence[float]) -> NDArray[np.float64]:
        """Return the distances along the chain from the arc lengths `s` (N,) to the nearest of some positions, metres.

        Without a position, the distances are infinite.
        """
        return np.min([np.full(len(s), np.inf), *(self.distance(s, t) for t in positions)], axis=0)


def passes_below(chain: Chain, crossings: Sequence[Crossing]) -> list[tuple[StrandPoint, StrandPoint]]:
    """Return where a chain is, or may be, the lower strand of a crossing: its position, and that of the other strand.

    At a crossing with less than `MIN_CERTAIN_CONFIDENCE`, either strand may be the lower one.
    """
    pairs = [(x.under, x.over) for x in crossings]
    pairs += [(x.over, x.under) for x in crossings if x.confidence < MIN_CERTAIN_CONFIDENCE]
    return [(below, above) for below, above in pairs if below.chain == chain.id]
