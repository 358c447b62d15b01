"""Matching of recognised chains and true strings, and of positions along them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.simulation.evaluation.curve_distance import Line

COMPARED = 200
"""Number of points of a chain and a string that are compared."""


@dataclass(frozen=True)
class Pair:
    """A chain and its string."""

    chain: int
    string: int
    backwards: bool
    """Whether the chain runs against its string."""
    origin: float
    """Share of the string's length at which the chain's first point lies, or its last point if it runs backwards. It is
    0 for an open string."""
    apart_m: float
    """Mean distance of chain and string at equal shares of their lengths."""
    chain_length_m: float
    string_length_m: float

    def on_string(self, s_m: float) -> float:
        """Return the arc length along the string for the arc length `s_m` along the chain.

        The accuracy is half a per cent for a closed string.
        """
        # a chain of coincident points has no length
        share = s_m / self.chain_length_m if self.chain_length_m > 0 else 0.0
        share = 1.0 - share if self.backwards else share
        # an open string does not wrap around
        share = (self.origin + share) % 1.0 if self.origin else share
        return share * self.string_length_m


def pair_up(chains: Sequence[Line], strings: Sequence[Line]) -> dict[int, Pair]:
    """Return the pairs with the smallest sum of distances, by chain. Surplus chains and strings have no pair."""
    from scipy.optimize import linear_sum_assignment

    if not (chains and strings):
        return {}
    pairs = [[_aligned(j, chain, i, string) for i, string in enumerate(strings)] for j, chain in enumerate(chains)]
    rows, columns = linear_sum_assignment([[pair.apart_m for pair in row] for row in pairs])
    return {int(j): pairs[j][i] for j, i in zip(rows, columns, strict=True)}


def _aligned(j: int, chain: Line, i: int, string: Line) -> Pair:
    """Return the pair of chain j and string i in the better direction, and for a closed string at the best start."""
    true = string.even(COMPARED)
    # a closed string may start anywhere; the array is (shift, point)
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
