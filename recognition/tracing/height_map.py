"""What the measured surface shows from above: where a strand lies over a place, and where nothing does."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

ABOVE_SHARE = 1.5
"""A strand's own top is r above its centre line, that of another on top of it at least 2.2 r: between the two."""
NEAR_SHARE = 0.8
"""How far beside a place, as a share of r, the surface is looked at."""
COVERED_SHARE = 0.1
"""Share of the points above a place that must be high for it to be covered: a single one is noise."""


class HeightMap:
    """Looks down on a surface (M, 3)."""

    def __init__(self, surface: NDArray[np.float64]) -> None:
        self.surface = surface
        self._tree = KDTree(surface[:, :2])

    def over(self, places: NDArray[np.float64], r: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(N,) whether another strand lies over each of the places (N, 3) of a string of radius r, and whether
        nothing does."""
        pairs = KDTree(places[:, :2]).sparse_distance_matrix(self._tree, NEAR_SHARE * r, output_type="ndarray")
        row, below = pairs["i"], pairs["j"]
        counts = np.bincount(row, minlength=len(places))
        above = self.surface[below, 2] > places[row, 2] + ABOVE_SHARE * r
        return np.bincount(row, above, len(places)) > COVERED_SHARE * np.maximum(counts, 1), counts == 0
