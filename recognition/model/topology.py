"""Topology of the strings: Gauss code and P-data.

P-data is a representation for knot planners. The paper (section I, references [5] and [6]) describes P-data as elements
"such as end, node and segment" and a matrix of their relations. The paper does not define the entries of the matrix;
`PData` defines them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TopologyError
from recognition.model.chains import Chain, Crossing, End, StrandPoint

Role = Literal["over", "under"]
"""Whether a chain passes over or under the other strand at a crossing."""

OVER, UNDER, JOINED = 1, -1, 2
"""Entries of `PData.matrix`: over pass of a crossing, under pass of a crossing, and end of a chain."""


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
    return [[[crossing.id, role, crossing.sign] for _, role, crossing in along] for along in _passes(chains, crossings)]


def p_data(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> PData:
    """Return the P-data of the chains and their crossings.

    Args:
        chains: The chains, each with a different id.
        crossings: The crossings of these chains, in any order.

    Raises:
        TopologyError: A crossing refers to a chain that does not exist.
    """
    passes = _passes(chains, crossings)
    ends: list[Element] = []
    for chain in chains:
        if not chain.closed:
            ends += [
                EndElement(chain.id, "first", 0.0, chain.ends[0]),
                EndElement(chain.id, "last", chain.length_m, chain.ends[1]),
            ]
    passed = {crossing.id: crossing for along in passes for _, _, crossing in along}
    element_index = {crossing_id: len(ends) + k for k, crossing_id in enumerate(passed)}
    elements = [*ends, *(CrossingElement(x.id, x.sign, x.over, x.under) for x in passed.values())]
    entries: list[tuple[int, int, int]] = []
    end = 0
    for chain, along in zip(chains, passes, strict=True):
        stops = [(s, element_index[crossing.id], OVER if role == "over" else UNDER) for s, role, crossing in along]
        if not chain.closed:
            stops = [(0.0, end, JOINED), *stops, (chain.length_m, end + 1, JOINED)]
            end += 2
        elif stops:
            stops = [*stops, (stops[0][0] + chain.length_m, *stops[0][1:])]
        else:
            entries.append((len(elements), len(elements), JOINED))
            elements.append(SegmentElement(chain.id, (0.0, chain.length_m)))
        for (s, previous, leaving), (t, following, arriving) in pairwise(stops):
            segment = len(elements)
            entries += [(previous, segment, leaving), (segment, following, arriving)]
            elements.append(SegmentElement(chain.id, (s, t)))
    matrix = np.zeros((len(elements), len(elements)), dtype=np.int8)
    for i, j, value in entries:
        matrix[i, j] = value
    return PData(tuple(elements), matrix)


def _passes(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> list[list[tuple[float, Role, Crossing]]]:
    """Return the crossing passes of each chain, (arc length, role, crossing), sorted along the chain.

    The result does not depend on the order of `crossings`.
    """
    passes: dict[int, list[tuple[float, Role, Crossing]]] = {chain.id: [] for chain in chains}
    for crossing in crossings:
        positions: tuple[tuple[Role, StrandPoint], ...] = (("over", crossing.over), ("under", crossing.under))
        for role, position in positions:
            if position.chain not in passes:
                raise TopologyError(
                    f"crossing {crossing.id} refers to chain {position.chain}, which is not in the model"
                )
            passes[position.chain].append((position.s_m, role, crossing))

    def sort_key(entry: tuple[float, Role, Crossing]) -> tuple[float, Role, int, float]:
        s, role, crossing = entry
        other = crossing.under if role == "over" else crossing.over
        return s, role, other.chain, other.s_m

    return [sorted(passes[chain.id], key=sort_key) for chain in chains]
