"""Which recognised chain is which true string, and where a place on the one lies on the other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.simulation.evaluation.curve_distance import Line

COMPARED = 200
"""Points of a chain and a string that are compared to find out which belong together."""


@dataclass(frozen=True)
class Pair:
    """A chain and the string that it is taken for."""

    chain: int
    string: int
    backwards: bool
    """Whether the chain runs against its string."""
    origin: float
    """Share of the string's length at which the chain's first point (backwards: its last) lies; 0 on an open one."""
    apart_m: float
    """Mean distance of the two at equal shares of their lengths."""
    chain_length_m: float
    string_length_m: float

    def on_string(self, s_m: float) -> float:
        """Arc length along the string of the place at `s_m` along the chain (to half a per cent on a closed one)."""
        # A chain whose points all coincide has no length, and no place but its beginning.
        share = s_m / self.chain_length_m if self.chain_length_m > 0 else 0.0
        share = 1.0 - share if self.backwards else share
        # An open string has no place beyond its ends to come round to.
        share = (self.origin + share) % 1.0 if self.origin else share
        return share * self.string_length_m


def pair_up(chains: Sequence[Line], strings: Sequence[Line]) -> dict[int, Pair]:
    """The pairing of least distance in sum, by chain; whatever is left over of either has no pair."""
    from scipy.optimize import linear_sum_assignment

    if not (chains and strings):
        return {}
    pairs = [[_aligned(j, chain, i, string) for i, string in enumerate(strings)] for j, chain in enumerate(chains)]
    rows, columns = linear_sum_assignment([[pair.apart_m for pair in row] for row in pairs])
    return {int(j): pairs[j][i] for j, i in zip(rows, columns, strict=True)}


def _aligned(j: int, chain: Line, i: int, string: Line) -> Pair:
    """Chain j laid along string i either way; along a closed string from any place on it."""
    true = string.even(COMPARED)
    # A circle may begin anywhere; (shift, point) gives the place on the string that is compared.
    shifts = np.arange(COMPARED if string.closed else 1)[:, None]
    places = (np.arange(COMPARED)[None] + shifts) % COMPARED
    best = (np.inf, 0, False)
    for backwards in (False, True):
        points = chain.even(COMPARED)[:: -1 if backwards else 1]
        if string.closed:
            apart = np.linalg.norm(true[:, None] - points[None], axis=2)
            mean = apart[places, np.arange(COMPARED)[None]].mean(axis=1)
        else:
            mean = np.array([np.linalg.norm(points - true, axis=1).mean()])
        shift = int(mean.argmin())
        best = min(best, (float(mean[shift]), shift, backwards))
    apart_m, shift, backwards = best
    return Pair(j, i, backwards, shift / COMPARED, apart_m, chain.length_m, string.length_m)
