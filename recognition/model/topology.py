"""The topology of the strings, without lengths: Gauss code and P-data.

P-data is a form that knot planners use. The paper (section I, its references [5] and [6]) describes it as elements
"such as end, node and segment" whose relations are in a matrix. It leaves the matrix open; `PData` defines ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:  # the model's document holds what is made here
    from recognition.model.model import Chain, Crossing, End, StrandPoint

Role = Literal["over", "under"]

OVER, UNDER, JOINED = 1, -1, 2
"""Entries of the matrix: at a crossing's over or under pass; at an end, or of a closed chain's segment with itself."""


class TopologyError(ValueError):
    """Chains and crossings contradict one another."""

    slug = "topology"


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

    def to_json(self) -> dict[str, Any]:
        """Return `{"elements": [...], "matrix": [[...]]}`, with lengths rounded to a micrometre."""
        elements = [{"id": number} | _element_json(element) for number, element in enumerate(self.elements)]
        return {"elements": elements, "matrix": self.matrix.tolist()}


def gauss_code(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> list[list[list[Any]]]:
    """For each chain the crossings that it meets, in order: `[crossing id, "over" or "under", sign]`.

    Raises:
        TopologyError: a crossing names a chain that is not there.
    """
    return [[[x.id, role, x.sign] for _, role, x in met] for met in _passes(chains, crossings)]


def p_data(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> PData:
    """The P-data of chains and their crossings.

    Raises:
        TopologyError: a crossing names a chain that is not there.
    """
    passes = _passes(chains, crossings)
    ends: list[Element] = []
    for chain in chains:
        if not chain.closed:
            ends += [
                EndElement(chain.id, "first", 0.0, chain.ends[0]),
                EndElement(chain.id, "last", chain.length_m, chain.ends[1]),
            ]
    met = {x.id: x for along in passes for _, _, x in along}
    place = {number: len(ends) + k for k, number in enumerate(met)}
    elements = [*ends, *(CrossingElement(x.id, x.sign, x.over, x.under) for x in met.values())]
    links: list[tuple[int, int, int]] = []
    end = 0
    for chain, along in zip(chains, passes, strict=True):
        stops = [(s, place[x.id], OVER if role == "over" else UNDER) for s, role, x in along]
        if not chain.closed:
            stops = [(0.0, end, JOINED), *stops, (chain.length_m, end + 1, JOINED)]
            end += 2
        elif stops:
            stops = [*stops, (stops[0][0] + chain.length_m, *stops[0][1:])]
        else:
            links.append((len(elements), len(elements), JOINED))
            elements.append(SegmentElement(chain.id, (0.0, chain.length_m)))
        for (s, before, leaving), (t, after, arriving) in pairwise(stops):
            segment = len(elements)
            links += [(before, segment, leaving), (segment, after, arriving)]
            elements.append(SegmentElement(chain.id, (s, t)))
    matrix = np.zeros((len(elements), len(elements)), dtype=np.int8)
    for i, j, how in links:
        matrix[i, j] = how
    return PData(tuple(elements), matrix)


def _passes(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> list[list[tuple[float, Role, Crossing]]]:
    """For each chain its passes through crossings, in order along it, whatever the crossings' order."""
    passes: dict[int, list[tuple[float, Role, Crossing]]] = {chain.id: [] for chain in chains}
    for x in crossings:
        both: tuple[tuple[Role, StrandPoint], ...] = (("over", x.over), ("under", x.under))
        for role, strand in both:
            if strand.chain not in passes:
                raise TopologyError(f"crossing {x.id} is of chain {strand.chain}, which is not in the model")
            passes[strand.chain].append((strand.s_m, role, x))

    def order(entry: tuple[float, Role, Crossing]) -> tuple[float, Role, int, float]:
        s, role, x = entry
        other = x.under if role == "over" else x.over
        return s, role, other.chain, other.s_m

    return [sorted(passes[chain.id], key=order) for chain in chains]


def _element_json(element: Element) -> dict[str, Any]:
    match element:
        case EndElement():
            s = round(element.s_m, 6)
            return {"kind": "end", "chain": element.chain, "which": element.which, "s_m": s, "end": element.end}
        case CrossingElement():
            over, under = ({"chain": p.chain, "s_m": round(p.s_m, 6)} for p in (element.over, element.under))
            return {
                "kind": "crossing", "crossing": element.crossing, "sign": element.sign, "over": over, "under": under
            }  # fmt: skip
        case SegmentElement():
            return {"kind": "segment", "chain": element.chain, "s_m": [round(s, 6) for s in element.s_m]}
