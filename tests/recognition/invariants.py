"""Invariants of reversed and mirrored strings, and Gauss codes read back from P-data."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.topology import OVER, CrossingElement, EndElement, PData, SegmentElement

Strings = tuple[tuple[Chain, ...], tuple[Crossing, ...]]
"""Chains, and how they cross."""


def gauss_code_of(data: PData) -> list[list[list[Any]]]:
    """Return the Gauss code of P-data, from its matrix and the ids and signs of its crossings."""
    segments: dict[int, list[int]] = {}
    for number, element in enumerate(data.elements):
        if isinstance(element, SegmentElement):
            segments.setdefault(element.chain, []).append(number)
    return [_walk(data, numbers) for numbers in segments.values()]


def _walk(data: PData, segments: list[int]) -> list[list[Any]]:
    """Return the crossings from the first segment of a chain on; in a closed chain it follows the first pass."""
    before = int(np.flatnonzero(data.matrix[:, segments[0]])[0])
    closed = not isinstance(data.elements[before], EndElement)
    # A closed chain's first point lies in its last segment.
    segment, code = segments[-1] if closed else segments[0], []
    for _ in segments:
        after = int(np.flatnonzero(data.matrix[segment])[0])
        element = data.elements[after]
        if not isinstance(element, CrossingElement):
            break
        role = data.matrix[segment, after]
        code.append([element.crossing, "over" if role == OVER else "under", element.sign])
        segment = int(np.flatnonzero(data.matrix[after] == role)[0])
    return code


def turned_round(chains: Sequence[Chain], crossings: Sequence[Crossing], chain: int) -> Strings:
    """Return the same strings with the direction of one chain, given by its id, reversed.

    Signs of its crossings with itself stay, those of its crossings with others flip.
    """
    old = next(c for c in chains if c.id == chain)
    new = replace(
        old,
        points=old.points[::-1].copy(),
        sigma_m=old.sigma_m[::-1].copy(),
        views=old.views[::-1].copy(),
        ends=(old.ends[1], old.ends[0]),
    )
    last = float(old.arc_length_m[-1])

    def moved(strand: StrandPoint) -> StrandPoint:
        if strand.chain != chain:
            return strand
        s = last - strand.s_m
        return replace(strand, s_m=s % old.length_m if old.closed else s)

    def turned(x: Crossing) -> Crossing:
        flips = (x.over.chain == chain) != (x.under.chain == chain)
        return replace(x, over=moved(x.over), under=moved(x.under), sign=-x.sign if flips else x.sign)

    return tuple(new if c.id == chain else c for c in chains), tuple(turned(x) for x in crossings)


def mirrored(chains: Sequence[Chain], crossings: Sequence[Crossing]) -> Strings:
    """Return the strings mirrored at the plane y = 0: over stays over, and every sign flips."""
    flip = np.array([1.0, -1.0, 1.0])
    return (
        tuple(replace(c, points=c.points * flip) for c in chains),
        tuple(replace(x, point=x.point * flip, sign=-x.sign) for x in crossings),
    )


def writhe(crossings: Sequence[Crossing], chain: int) -> int:
    """Return the sum of the signs of the crossings of a chain with itself. It is the same in both directions."""
    return sum(x.sign for x in crossings if x.over.chain == chain == x.under.chain)


def linking_number(chains: Sequence[Chain], crossings: Sequence[Crossing], a: int, b: int) -> int:
    """Return the linking number of two closed chains, given by their ids: half the sum of their signs."""
    assert all(c.closed for c in chains if c.id in (a, b)), "of open chains the number has no meaning"
    signs = [x.sign for x in crossings if {x.over.chain, x.under.chain} == {a, b}]
    assert len(signs) % 2 == 0, "a crossing was missed: closed chains cross an even number of times"
    return sum(signs) // 2
