"""Ends of chains that may not be ends of a string: the string may continue there."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import end_direction
from recognition.messages import format_position
from recognition.model.chains import Chain
from recognition.parameters import ChainParameters
from recognition.refinement.end_merging import MAX_FACING_COSINE

DIRECTION_LENGTH_RADII = 2.0
"""Length of the chain, in radii, that gives its direction at an end."""
MIN_AHEAD_COSINE = np.cos(np.radians(35))
"""A point is ahead of an end if, seen from the end, it is within this angle of the end's direction."""
MAX_CONTINUATION_RADII = 3.0
"""A point ahead is near if its distance is below this number of radii: unexplained surface begins 2 radii away."""
MAX_FRAGMENT_GAP_RADII = 1.5
"""Ends closer than this number of radii may belong to one string.

Two whole strings that lie end to end keep a distance because their ends are round, or they are recognised as one.
"""


def mark_unobserved_ends(
    chains: Sequence[Chain], unexplained: Sequence[NDArray[np.float64]], parameters: ChainParameters
) -> tuple[Chain, ...]:
    """Mark the `free` ends that have unexplained surface ahead of them as `unseen`.

    The string may continue there: its end was not observed. The continuation may have been too short, or measured too
    badly, to be recognised as string.

    Args:
        chains: Chains of the model.
        unexplained: (M, 3) points of each piece of unexplained surface, metres, base frame.
        parameters: Radius r; a chain thicker than r uses its own radius.

    Returns:
        The chains, with changed ends. Closed chains are unchanged.

    Source:
        Ours.
    """
    if not unexplained:
        return tuple(chains)
    rest = np.vstack(unexplained)
    return tuple(chain if chain.closed else _mark_ends(chain, rest, parameters) for chain in chains)


def mark_fragmented_ends(chains: Sequence[Chain]) -> tuple[tuple[Chain, ...], list[str]]:
    """Mark pairs of ends that face each other within `MAX_FRAGMENT_GAP_RADII` as `unseen`.

    A string that was recognised in fragments, for example after a wrong radius, has two ends too many. A robot that
    pulls one of these ends also moves the other. The data do not show whether it is one string or two strings end to
    end.

    Args:
        chains: Chains of the model.

    Returns:
        The chains, with changed ends, and one ambiguity for each pair.

    Source:
        Ours.
    """
    ends = [(k, at) for k, chain in enumerate(chains) if not chain.closed for at in (0, 1)]
    points, directions = np.empty((len(ends), 3)), np.empty((len(ends), 3))
    for n, (k, at) in enumerate(ends):
        line = chains[k].points[:: -1 if at else 1]
        points[n], directions[n] = line[0], end_direction(line, DIRECTION_LENGTH_RADII * chains[k].radius_m)
    kinds = [list(chain.ends) for chain in chains]
    ambiguities = []
    for n, (k, at) in enumerate(ends):
        for m, (j, other) in enumerate(ends[:n]):
            max_gap = MAX_FRAGMENT_GAP_RADII * max(chains[k].radius_m, chains[j].radius_m)
            if np.linalg.norm(points[n] - points[m]) < max_gap and directions[n] @ directions[m] < MAX_FACING_COSINE:
                kinds[k][at] = kinds[j][other] = "unseen"
                pair = f"an end of chain {j} and an end of chain {k}" if j != k else f"the ends of chain {k}"
                position = format_position(points[n])
                ambiguities.append(
                    f"{pair} face each other at {position}: one string may continue there; check the radius"
                )
    return tuple(replace(chain, ends=(a, b)) for chain, (a, b) in zip(chains, kinds, strict=True)), ambiguities


def _mark_ends(chain: Chain, rest: NDArray[np.float64], parameters: ChainParameters) -> Chain:
    """Mark the ends of one open chain that continue in `rest` (M, 3)."""
    first, last = chain.ends
    # The unexplained surface begins farther away from a thicker chain.
    r = max(chain.radius_m, parameters.r)
    if _continues(chain.points, rest, r):
        first = "unseen"
    if _continues(chain.points[::-1], rest, r):
        last = "unseen"
    return replace(chain, ends=(first, last))


def _continues(line: NDArray[np.float64], rest: NDArray[np.float64], r: float) -> bool:
    """Return whether a point of `rest` (M, 3) is ahead of the first point of `line` (N, 3) and near it."""
    offset = rest - line[0]
    distance = np.linalg.norm(offset, axis=1)
    ahead = offset @ end_direction(line, DIRECTION_LENGTH_RADII * r) > MIN_AHEAD_COSINE * distance
    return bool((ahead & (distance < MAX_CONTINUATION_RADII * r)).any())
