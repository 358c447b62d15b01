"""Topology of the strings: Gauss code and P-data.

P-data is a representation for knot planners. The paper (section I, references [5] and [6]) describes P-data as elements
"such as end, node and segment" and a matrix of their relations. The paper does not define the entries of the matrix;
`PData` defines them.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TopologyError
from recognition.model.chains import Chain, Crossing, End, StrandPoint

Role = Literal["over", "under"]
"""Whether a chain passes over or under the other strand at a crossing."""

OVER = 1
"""Entry of `PData.matrix`: over pass of a crossing."""
UNDER = -1
"""Entry of `PData.matrix`: under pass of a crossing."""
JOINED = 2
"""Entry of `PData.matrix`: end of a chain, or the segment of a ring without crossings."""


@dataclass(frozen=True)
class EndElement:
    """One end of an open chain."""

    chain: int
    """Id of the chain."""
    which: Literal["first", "last"]
    """Which end of the chain."""
    s_m: float
    """Arc length of the end along the chain, metres."""
    end: End
    """Kind of the end, as in `Chain.ends`."""


@dataclass(frozen=True)
class CrossingElement:
    """A crossing of two strands, called "node" in the paper."""

    crossing: int
    """Id of the crossing."""
    sign: int
    """Crossing sign, +1 (right-handed) or -1 (left-handed)."""
    over: StrandPoint
    """Position of the crossing on the upper strand."""
    under: StrandPoint
    """Position of the crossing on the lower strand."""


@dataclass(frozen=True)
class SegmentElement:
    """The part of a chain from one end or crossing pass to the next."""

    chain: int
    """Id of the chain."""
    s_m: tuple[float, float]
    """Arc lengths of the first and the last point of the segment, metres. The last segment of a closed chain continues
    past the first point of the chain. The second arc length may therefore exceed the length of the chain."""


Element = EndElement | CrossingElement | SegmentElement


@dataclass(frozen=True, eq=False)
class PData:
    """P-data: ends, crossings and segments, and a matrix of their order along the chains.

    Every chain runs from its first point to its last point. `matrix[i, j]` is non-zero if element j directly follows
    element i along a chain: end to segment, segment to crossing, crossing to segment, or segment to end. The value is:

    - 1 (`OVER`) if the segment arrives at or leaves a crossing on the over pass;
    - -1 (`UNDER`) if the segment arrives at or leaves a crossing on the under pass;
    - 2 (`JOINED`) if the segment begins or stops at an end.

    A closed chain without crossings is one segment that follows itself, with the value 2.

    The row of a segment has one non-zero entry, for the successor. The column of a segment has one non-zero entry, for
    the predecessor. The row and the column of a crossing each have one entry 1 and one entry -1. The incidence matrix
    is `(matrix != 0) | (matrix.T != 0)`.

    The sign of a crossing gives the order of the four segments around the crossing. At a positive crossing, this order
    is, counter-clockwise from above: over leaving, under leaving, over arriving, under arriving.

    Source:
        Section I, references [5] and [6]. The values of the matrix are not in the paper.
    """

    elements: tuple[Element, ...]
    """Ends, then crossings, then segments. Ends and segments are in the order of the chains. Crossings are in the order
    in which the chains first reach them, whatever their ids."""
    matrix: NDArray[np.int8]
    """(E, E) successor matrix of the E elements, with the entries described above."""


def gauss_code(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> list[list[list[Any]]]:
    """Return the Gauss code: the crossings along each chain, in order.

    Args:
        chains: The chains, each with a different id.
        crossings: The crossings of these chains, in any order.

    Returns:
        One list per chain. Each entry is `[crossing id, "over" or "under", sign]`.

    Raises:
        TopologyError: A crossing refers to a chain that does not exist.
    """
    code = []
    for along in _passes(chains, crossings):
        code.append([[entry.crossing.id, entry.role, entry.crossing.sign] for entry in along])
    return code


def p_data(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> PData:
    """Return the P-data of the chains and their crossings.

    Args:
        chains: The chains, each with a different id.
        crossings: The crossings of these chains, in any order.

    Raises:
        TopologyError: A crossing refers to a chain that does not exist.
    """
    passes = _passes(chains, crossings)
    elements: list[Element] = []
    for chain in chains:
        if not chain.closed:
            elements.append(EndElement(chain.id, "first", 0.0, chain.ends[0]))
            elements.append(EndElement(chain.id, "last", chain.length_m, chain.ends[1]))
    element_of_crossing: dict[int, int] = {}
    for entry in itertools.chain.from_iterable(passes):
        crossing = entry.crossing
        if crossing.id not in element_of_crossing:
            element_of_crossing[crossing.id] = len(elements)
            elements.append(CrossingElement(crossing.id, crossing.sign, crossing.over, crossing.under))
    entries: list[tuple[int, int, int]] = []
    end = 0
    for chain, along in zip(chains, passes, strict=True):
        stops = [_Stop(entry.s_m, element_of_crossing[entry.crossing.id], entry.value) for entry in along]
        if not chain.closed:
            stops = [_Stop(0.0, end, JOINED), *stops, _Stop(chain.length_m, end + 1, JOINED)]
            end += 2
        elif stops:
            # The last segment of a ring ends at its first crossing, one turn later.
            stops.append(replace(stops[0], s_m=stops[0].s_m + chain.length_m))
        else:
            entries.append((len(elements), len(elements), JOINED))
            elements.append(SegmentElement(chain.id, (0.0, chain.length_m)))
        for start, stop in pairwise(stops):
            segment = len(elements)
            entries.append((start.element, segment, start.value))
            entries.append((segment, stop.element, stop.value))
            elements.append(SegmentElement(chain.id, (start.s_m, stop.s_m)))
    matrix = np.zeros((len(elements), len(elements)), dtype=np.int8)
    for row, column, value in entries:
        matrix[row, column] = value
    return PData(tuple(elements), matrix)


@dataclass(frozen=True)
class _Stop:
    """An end or a crossing on the way along a chain, where a segment begins or ends."""

    s_m: float
    """Arc length, metres."""
    element: int
    """Index of the element."""
    value: int
    """Entry of the matrix."""


@dataclass(frozen=True)
class _Pass:
    """A pass of a chain over or under another strand."""

    s_m: float
    """Arc length along the chain, metres."""
    role: Role
    crossing: Crossing

    @property
    def value(self) -> int:
        """Entry of the matrix."""
        return OVER if self.role == "over" else UNDER

    @property
    def sort_key(self) -> tuple[float, Role, int, float]:
        """Order along the chain, which does not depend on the order of the crossings."""
        other = self.crossing.under if self.role == "over" else self.crossing.over
        return self.s_m, self.role, other.chain, other.s_m


def _passes(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> list[list[_Pass]]:
    """Return the crossing passes of each chain, sorted along the chain.

    The result does not depend on the order of `crossings`.
    """
    passes: dict[int, list[_Pass]] = {chain.id: [] for chain in chains}
    for crossing in crossings:
        positions: tuple[tuple[Role, StrandPoint], ...] = (("over", crossing.over), ("under", crossing.under))
        for role, position in positions:
            if position.chain not in passes:
                raise TopologyError(
                    f"crossing {crossing.id} refers to chain {position.chain}, which is not in the model"
                )
            passes[position.chain].append(_Pass(position.s_m, role, crossing))
    return [sorted(passes[chain.id], key=lambda entry: entry.sort_key) for chain in chains]
