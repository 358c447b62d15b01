"""Match recognised chains to true strings, and arc lengths along a chain to arc lengths along its string."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.simulation.evaluation.curve_distance import Polyline

SAMPLE_COUNT = 200
"""Number of evenly spaced points of each line for the comparison of a chain with a string."""


@dataclass(frozen=True)
class ChainMatch:
    """A recognised chain and the true string to which it is matched."""

    chain: int
    """Index of the chain."""
    string: int
    """Index of the string."""
    backwards: bool
    """Whether the direction of the chain is opposite to the direction of the string."""
    start_share: float
    """Share of the string's length, 0 to 1, at which the chain begins. If `backwards` is true, it is the share at which
    the chain ends. It is 0 for an open string."""
    mean_distance_m: float
    """Mean distance between points at equal shares of the two lengths, metres."""
    chain_length_m: float
    """Length of the chain, metres."""
    string_length_m: float
    """Length of the string, metres."""

    def arc_length_on_string(self, s_m: float) -> float:
        """Return the arc length along the string for the arc length `s_m` along the chain, both in metres.

        For a closed string, the result is accurate to 0.5 % of the string's length (one of `SAMPLE_COUNT` points).
        """
        # A chain of coincident points has the length zero.
        share = s_m / self.chain_length_m if self.chain_length_m > 0 else 0.0
        share = 1.0 - share if self.backwards else share
        # Only a closed string has a `start_share` other than 0. Its arc length wraps around.
        share = (self.start_share + share) % 1.0 if self.start_share else share
        return share * self.string_length_m


def match_chains(chains: Sequence[Polyline], strings: Sequence[Polyline]) -> dict[int, ChainMatch]:
    """Match each chain to at most one string, so that the sum of the mean distances is smallest.

    Args:
        chains: Recognised lines.
        strings: True lines.

    Returns:
        The pair of each matched chain, by the index of the chain. Surplus chains and surplus strings have no pair.
    """
    from scipy.optimize import linear_sum_assignment

    if not (chains and strings):
        return {}
    pairs = [[_align(j, chain, i, string) for i, string in enumerate(strings)] for j, chain in enumerate(chains)]
    rows, columns = linear_sum_assignment([[pair.mean_distance_m for pair in row] for row in pairs])
    return {int(j): pairs[j][i] for j, i in zip(rows, columns, strict=True)}


def _align(j: int, chain: Polyline, i: int, string: Polyline) -> ChainMatch:
    """Return the pair of chain j and string i with the best direction, and the best start on a closed string."""
    true = string.evenly_spaced(SAMPLE_COUNT)
    # A closed string may begin at any point. The arrays have the shape (shifts, points).
    shifts = np.arange(SAMPLE_COUNT if string.closed else 1)[:, None]
    true_indices = (np.arange(SAMPLE_COUNT)[None] + shifts) % SAMPLE_COUNT
    best = (np.inf, 0, False)
    for backwards in (False, True):
        points = chain.evenly_spaced(SAMPLE_COUNT)[:: -1 if backwards else 1]
        if string.closed:
            apart = np.linalg.norm(true[:, None] - points[None], axis=2)
            mean = apart[true_indices, np.arange(SAMPLE_COUNT)[None]].mean(axis=1)
        else:
            mean = np.array([np.linalg.norm(points - true, axis=1).mean()])
        shift = int(mean.argmin())
        best = min(best, (float(mean[shift]), shift, backwards))
    mean_distance_m, shift, backwards = best
    return ChainMatch(j, i, backwards, shift / SAMPLE_COUNT, mean_distance_m, chain.length_m, string.length_m)
