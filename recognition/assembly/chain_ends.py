"""Detection of chain ends at which the string may continue."""

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
"""Length of chain from which the direction of an end is measured, in radii."""
MIN_AHEAD_COSINE = np.cos(np.radians(35))
"""Minimum cosine between the direction of an end and the direction from the end to a point ahead (35 degrees)."""
MAX_CONTINUATION_RADII = 3.0
"""Maximum distance from an end to its continuation, in radii. Unexplained surface begins at a distance of 2 radii."""
MAX_FACING_GAP_RADII = 1.5
"""Maximum gap between two facing ends that may belong to one string, in radii of the thicker chain.

Two whole strings that lie end to end have a larger gap because their ends are round, or they are recognised as one.
"""


def mark_unobserved_ends(
    chains: Sequence[Chain], unexplained: Sequence[NDArray[np.float64]], parameters: ChainParameters
) -> tuple[Chain, ...]:
    """Mark an end as `unseen` if unexplained surface lies ahead of the end.

    The string may continue there, so its end was not observed. The continuation was perhaps too short or too poorly
    measured to be recognised.

    Args:
        chains: Chains of the model.
        unexplained: (M, 3) points of each piece of unexplained surface, metres, base frame.
        parameters: Method parameters; uses the radius r. A chain thicker than r uses its own radius.

    Returns:
        The chains with the marked ends. Closed chains are unchanged.
    """
    if not unexplained:
        return tuple(chains)
    rest = np.vstack(unexplained)
    return tuple(chain if chain.closed else _mark_ends(chain, rest, parameters) for chain in chains)


def mark_facing_ends(chains: Sequence[Chain]) -> tuple[tuple[Chain, ...], list[str]]:
    """Mark two ends as `unseen` if they face each other within `MAX_FACING_GAP_RADII`.

    A wrong radius can split one string into two chains. In this case, pulling one chain also moves the other chain.
    The data do not show whether the two ends belong to one string or to two strings that lie end to end.

    Args:
        chains: Chains of the model.

    Returns:
        The chains with the marked ends, and one message for each pair of ends.
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
            max_gap = MAX_FACING_GAP_RADII * max(chains[k].radius_m, chains[j].radius_m)
            if np.linalg.norm(points[n] - points[m]) < max_gap and directions[n] @ directions[m] < MAX_FACING_COSINE:
                kinds[k][at] = kinds[j][other] = "unseen"
                pair = f"an end of chain {j} and an end of chain {k}" if j != k else f"the ends of chain {k}"
                position = format_position(points[n])
                ambiguities.append(
                    f"{pair} face each other at {position}: one string may continue there; check the radius"
                )
    return tuple(replace(chain, ends=(a, b)) for chain, (a, b) in zip(chains, kinds, strict=True)), ambiguities


def _mark_ends(chain: Chain, rest: NDArray[np.float64], parameters: ChainParameters) -> Chain:
    """Mark each end of an open chain as `unseen` if unexplained surface `rest` (M, 3) lies ahead of the end."""
    first, last = chain.ends
    # Unexplained surface begins at twice this radius from the chain.
    r = max(chain.radius_m, parameters.r)
    if _continues(chain.points, rest, r):
        first = "unseen"
    if _continues(chain.points[::-1], rest, r):
        last = "unseen"
    return replace(chain, ends=(first, last))


def _continues(line: NDArray[np.float64], rest: NDArray[np.float64], r: float) -> bool:
    """Return whether a point of `rest` (M, 3) lies near and ahead of the first point of `line` (N, 3)."""
    offset = rest - line[0]
    distance = np.linalg.norm(offset, axis=1)
    ahead = offset @ end_direction(line, DIRECTION_LENGTH_RADII * r) > MIN_AHEAD_COSINE * distance
    return bool((ahead & (distance < MAX_CONTINUATION_RADII * r)).any())
