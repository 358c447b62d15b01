"""Ends that are none: string that was measured ahead of a chain's end, and is in no chain."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import end_direction
from recognition.model.model import Chain
from recognition.parameters import ChainParameters

LOOKED_AT = 2.0
"""Length of a chain, in radii, from which its direction at an end is taken."""
IN_LINE = np.cos(np.radians(35))
"""What lies within this angle of an end's direction, seen from the end, is ahead of it."""
NEAR = 3.0
"""It is near within so many radii: what is in no chain begins 2 from a chain's last point."""


def mark_unobserved_ends(
    chains: Sequence[Chain], left_over: Sequence[NDArray[np.float64]], parameters: ChainParameters
) -> tuple[Chain, ...]:
    """The chains, with those `free` ends `unseen` that have one of the `left_over` pieces (M, 3) ahead of them.

    If what is in no chain lies in line with an end, and near it, the string may go on there: it was not seen to stop.
    Part of it was too short, or too badly seen, to be told from other things.
    """
    if not left_over:
        return tuple(chains)
    rest = np.vstack(left_over)
    return tuple(chain if chain.closed else _without_missed_ends(chain, rest, parameters) for chain in chains)


def _without_missed_ends(chain: Chain, rest: NDArray[np.float64], parameters: ChainParameters) -> Chain:
    first, last = chain.ends
    # From a thicker chain, what is in none begins farther away.
    r = max(chain.radius_m, parameters.r)
    if _goes_on(chain.points, rest, r):
        first = "unseen"
    if _goes_on(chain.points[::-1], rest, r):
        last = "unseen"
    return replace(chain, ends=(first, last))


def _goes_on(line: NDArray[np.float64], rest: NDArray[np.float64], r: float) -> bool:
    """Whether some of `rest` (M, 3) is ahead of the first point of `line` (N, 3) and near it."""
    offset = rest - line[0]
    distance = np.linalg.norm(offset, axis=1)
    ahead = offset @ end_direction(line, LOOKED_AT * r) > IN_LINE * distance
    return bool((ahead & (distance < NEAR * r)).any())
