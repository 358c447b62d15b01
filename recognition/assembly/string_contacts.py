"""Contacts of chains with the strands under them: strings in a heap lie on strings."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from recognition.model.chains import Chain

MIN_OVER_SHARE = 0.5
"""Minimum height of a strand above the strand that supports it, as a share of the sum of both radii. A strand that is
less high lies beside it."""
MIN_ALONG_RADII = 6.0
"""Minimum distance along a chain between two strands of it that touch, in radii."""


def rests_on_both_sides(chain: Chain, chains: Sequence[Chain], table_m: float, max_gap_m: float) -> bool:
    """Return whether both halves of a chain lie on the table or on another strand.

    A string that rests has its weight supported on both sides of its middle. The edge of an object does not lie on
    strings.

    Args:
        chain: One of `chains`.
        chains: All chains of the scene.
        table_m: Height of the table or object beside the chain, metres.
        max_gap_m: Maximum gap between two surfaces in contact, metres.
    """
    points = chain.points
    s = chain.arc_length_m
    supported = points[:, 2] - chain.radius_m - table_m < max_gap_m
    for other in chains:
        reach = chain.radius_m + other.radius_m + max_gap_m
        near = KDTree(points).sparse_distance_matrix(KDTree(other.points), reach, output_type="ndarray")
        upper = near["i"]
        lower = near["j"]
        is_over = points[upper, 2] - other.points[lower, 2] > MIN_OVER_SHARE * (chain.radius_m + other.radius_m)
        if other is chain:
            is_over &= np.abs(s[upper] - s[lower]) > MIN_ALONG_RADII * chain.radius_m
        supported[upper[is_over]] = True
    is_first_half = s < s[-1] / 2
    return bool(supported[is_first_half].any() and supported[~is_first_half].any())
