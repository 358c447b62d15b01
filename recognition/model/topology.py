"""The topology of the strings, without lengths: Gauss code and P-data.

P-data is a form that knot planners use. The paper (section I, its references [5] and [6]) describes it as elements
"such as end, node and segment" whose relations are in a matrix. It leaves the matrix open; `PData` defines ours.
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
"""Whether a chain passes a crossing over or under the other strand."""

OVER, UNDER, JOINED = 1, -1, 2
"""Entries of the matrix of `PData`: over pass of a crossing, under pass, and end of a chain."""


@dataclass(frozen=True)
class EndElement:
    """One end of an open chain."""

    chain: int
    """Id of the chain."""
    which: Literal["first", "last"]
    """Which end of the chain."""
    s_m: float
    """Arc length along the chain, metres."""
    end: End
    """`free` or `unseen`, as in the chain."""


@dataclass(frozen=True)
class CrossingElement:
    """A crossing, the node of two passes."""

    crossing: int
    """Id of the crossing."""
    sign: int
    """Right-handed crossing sign, +1 or -1."""
    over: StrandPoint
    """Position on the upper strand."""
    under: StrandPoint
    """Position on the lower strand."""


@dataclass(frozen=True)
class SegmentElement:
    """The part of a string from one end or crossing pass to the next."""

    chain: int
    """Id of the chain."""
    s_m: tuple[float, float]
    """Arc lengths of its beginning and end, metres. The last segment of a closed chain continues past the first point
    of the chain, so its end is larger than the length of the chain."""


Element = EndElement | CrossingElement | SegmentElement


@dataclass(frozen=True, eq=False)
class PData:
    """Ends, crossings and segments, and the order in which they follow one another along the chains.

    `matrix[i, j]` is not 0 if element j follows element i along a chain, from its first point to its last: end to
    segment, segment to crossing, crossing to segment, segment to end. The value says how:

    - 1 (`OVER`): the segment arrives at, or leaves, the over pass of the crossing;
    - -1 (`UNDER`): the segment arrives at, or leaves, the under pass of the crossing;
    - 2 (`JOINED`): the segment begins or stops at the end. A closed chain without crossings is one segment that
      follows itself.

    The row of a segment holds its successor, and its column its predecessor. The row and the column of a crossing hold
    one 1 and one -1 each. `(matrix != 0) | (matrix.T != 0)` is the incidence. The sign gives the order of the four
    segments around a crossing. At a positive crossing, counter-clockwise from above, they are: over leaving, under
    leaving, over arriving, under arriving.

    Source:
        Section I of the paper, its references [5] and [6]. The values of the matrix are ours.
    """

    elements: tuple[Element, ...]
    """Ends in the order of the chains, then crossings in the order in which the chains first reach them, then segments
    along the chains. This order does not depend on the numbers of the crossings."""
    matrix: NDArray[np.int8]
    """(E, E) for E elements."""


def gauss_code(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> list[list[list[Any]]]:
    """Return for each chain the crossings along it, in order.

    Args:
        chains: The chains, each with a different id.
        crossings: The crossings of these chains, in any order.

    Returns:
        For each chain a list of `[crossing id, "over" or "under", sign]`.

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
    """Return for each chain its passes through crossings along it, whatever the order of `crossings`."""
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
