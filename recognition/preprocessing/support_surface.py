"""Support surface: what a string rests on, the table or a large flat object on it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.model.chains import Chain
from recognition.parameters import ChainParameters
from recognition.preprocessing.height_map import HeightMap

MIN_RAISED_M = 0.0012
"""Minimum height of an object under a string above the table, metres. The mean of many cells has less noise."""
MIN_RAISED_SCATTERS = 2.0
"""The same height in standard deviations of patches of the table, if that is more."""
RAISED_PERCENTILE = 10
"""Percentile of the heights beside a string. The object must lie under the string along nearly all its length."""
EDGE_M = 0.002
"""Distance from the surface of a string, seen from above, within which pixels of its edge hide the floor, metres.

Beyond it, on simulated scans, 99 % of the cells are within 0.5 mm of the table.
"""
EDGE_RADII = 1.0
"""The same distance in radii of the string, if that is more. Matching windows of a stereo camera raise the floor so far
beside a string."""
MAX_POSITIONS = 40
"""Maximum number of positions along a string at which the height beside it is measured."""
MAX_DISTANCE_M = 0.08
"""Maximum distance from a string, seen from above, at which the surface of the object under it is removed, metres. It
is more than a gripper covers."""


@dataclass(frozen=True, eq=False)
class SupportSurface:
    """The table plane, and what was measured on it."""

    table_z_m: float = 0.0
    """Height of the table plane, metres, base frame."""
    heights: HeightMap | None = None
    """Height map of the workspace; None if only the table plane is known."""
    is_matched: bool = False
    """Whether pixel locking or the bands of strings show that the depth was matched in windows."""
    scatter_m: float = 0.0
    """Standard deviation of patches of the table, as wide as a string, metres; 0 if unknown."""

    def height_under(self, line: NDArray[np.float64], radius_m: float) -> float:
        """Return the height of the surface that a string rests on.

        Args:
            line: (N, 3) points of the centre line, metres, base frame.
            radius_m: Radius of the string, metres.

        Returns:
            `table_z_m`, or the height of the object on both sides of the string along nearly all its length, metres,
            base frame.
        """
        if self.heights is None or self.heights.z_m.size == 0:
            return self.table_z_m
        step = -(-len(line) // MAX_POSITIONS)
        beside = self.heights.floor_beside(line[::step, :2], radius_m + max(EDGE_M, EDGE_RADII * radius_m))
        if not np.isfinite(beside).any():
            return self.table_z_m
        height = float(np.nanpercentile(beside, RAISED_PERCENTILE))
        if height > self.table_z_m + max(MIN_RAISED_M, MIN_RAISED_SCATTERS * self.scatter_m):
            return height
        return self.table_z_m

    def remove_from(
        self, surface: NDArray[np.float64], chains: Sequence[Chain], parameters: ChainParameters
    ) -> NDArray[np.float64]:
        """Remove the surface of the objects that strings rest on, as the height threshold removes the table.

        Args:
            surface: (N, 3) measured points, metres, base frame.
            chains: Chains of the scene.
            parameters: Method parameters; uses the height threshold z_t.

        Returns:
            (M, 3) the points that are more than z_t above the object under the nearest chain, more than
            `MAX_DISTANCE_M` from it, or nearest to a chain that rests on the table.
        """
        heights = np.array([self.height_under(chain.points, chain.radius_m) for chain in chains])
        if not (heights > self.table_z_m).any():
            return surface
        number = np.repeat(np.arange(len(chains)), [len(chain.points) for chain in chains])
        lines = KDTree(np.vstack([chain.points[:, :2] for chain in chains]))
        distance, nearest = lines.query(surface[:, :2])
        height = heights[number[np.asarray(nearest)]]
        is_support = (height > self.table_z_m) & (surface[:, 2] < height + parameters.z_t)
        return surface[~is_support | (np.asarray(distance) > MAX_DISTANCE_M)]
