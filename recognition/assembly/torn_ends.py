"""Ends that face one another where two strings would be in one place: one string, torn in two."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recognition.assembly.missed_ends import LOOKED_AT
from recognition.geometry.polyline import end_direction
from recognition.messages import format_position
from recognition.model.model import Chain
from recognition.refinement.end_merging import OPPOSITE

NEAR = 1.5
"""Ends that face one another within so many radii: whole strings end to end are as far apart as their ends are round,
or are read as one."""


def mark_fragmented_ends(chains: Sequence[Chain]) -> tuple[tuple[Chain, ...], list[str]]:
    """The chains, with ends `unseen` that face another one within `NEAR`, and in words where that is.

    A string that was torn, as by a radius told wrong, has two ends more than it has: whoever pulls one of them moves
    the other. Which it is, or whether two strings were laid end to end, cannot be told.
    """
    ends = [(k, at) for k, chain in enumerate(chains) if not chain.closed for at in (0, 1)]
    points, ways = np.empty((len(ends), 3)), np.empty((len(ends), 3))
    for n, (k, at) in enumerate(ends):
        line = chains[k].points[:: -1 if at else 1]
        points[n], ways[n] = line[0], end_direction(line, LOOKED_AT * chains[k].radius_m)
    kinds = [list(chain.ends) for chain in chains]
    doubts = []
    for n, (k, at) in enumerate(ends):
        for m, (j, other) in enumerate(ends[:n]):
            near = NEAR * max(chains[k].radius_m, chains[j].radius_m)
            if np.linalg.norm(points[n] - points[m]) < near and ways[n] @ ways[m] < OPPOSITE:
                kinds[k][at] = kinds[j][other] = "unseen"
                whose = f"an end of chain {j} and one of chain {k}" if j != k else f"the ends of chain {k}"
                where = format_position(points[n])
                doubts.append(f"{whose} face one another at {where}: they may be one string, torn; check the radius")
    return tuple(replace(chain, ends=(a, b)) for chain, (a, b) in zip(chains, kinds, strict=True)), doubts
