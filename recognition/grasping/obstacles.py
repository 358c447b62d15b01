"""Obstacles for the gripper: all chains along their whole length, and all other objects above the table."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import close_polyline, points_at, resampled_lengths
from recognition.geometry.voxel_grid import voxel_centres, voxel_indices
from recognition.model.chains import Chain

MAX_STRING_NOISE_M = 0.004
"""Points within this distance of the surface of a string are noise of the string, metres.

Points farther away, but within one string radius of the surface, are noise unless they continue an object.
"""
VOXEL_M = 0.0015
"""Edge length of the voxels for the down-sampling of a dense surface, metres."""
MIN_THINNING_RATIO = 1.5
"""Minimum ratio of `VOXEL_M` to the point spacing for the down-sampling of a surface.

With this ratio, spheres at the voxel centres leave no holes in a plane.
"""
MIN_NEIGHBOUR_DISTANCE_M = 0.004
"""Minimum radius of the neighbourhood of a point, metres."""
NEIGHBOUR_SPACINGS = 3
"""Radius of the neighbourhood of a point, in point spacings, if larger than `MIN_NEIGHBOUR_DISTANCE_M`."""
MIN_NEIGHBOURS = 4
"""Minimum number of neighbours; a point with fewer neighbours is a flying pixel.

Within three point spacings, a point on a plane has 28 neighbours, and a point on a thin rod has 6.
"""
CELL_M = 0.01
"""Edge length of the grid cells that group the points of objects, metres. Cells far from the gripper are skipped."""


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Collision spheres of equal size that cover the measured objects, sorted by grid cell."""

    points: NDArray[np.float64]
    """(K, 3) sphere centres, metres, base frame."""
    radius_m: float
    """Radius of the spheres, metres."""
    count: NDArray[np.int64]
    """(C,) number of spheres in each cell; no cell is empty."""
    centre: NDArray[np.float64]
    """(C, 3) mean of the sphere centres in each cell, metres, base frame."""
    extent_m: NDArray[np.float64]
    """(C,) maximum distance of the sphere centres in each cell from `centre`, metres."""

    @cached_property
    def tree_xy(self) -> KDTree:
        """Search tree of `centre` in the table plane."""
        return KDTree(self.centre[:, :2])

    def spheres_of(self, cells: NDArray[np.intp]) -> NDArray[np.int64]:
        """Return the indices (M,) of the spheres of some cells (K,), cell by cell."""
        count = self.count[cells]
        first = np.cumsum(self.count) - self.count
        return np.arange(count.sum()) + np.repeat(first[cells] - (np.cumsum(count) - count), count)


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Collision spheres along all chains, and collision spheres of all other objects above the table."""

    points: NDArray[np.float64]
    """(M, 3) sphere centres on the chains, metres, base frame."""
    radius_m: NDArray[np.float64]
    """(M,) radius of each sphere, metres."""
    chain: NDArray[np.int64]
    """(M,) id of the chain of each sphere."""
    s_m: NDArray[np.float64]
    """(M,) arc length of each sphere centre along its chain, metres."""
    objects: ObjectPoints
    """Spheres of the objects that are not strings."""

    @cached_property
    def tree_xy(self) -> KDTree:
        """Search tree of `points` in the table plane."""
        return KDTree(self.points[:, :2])


def gather_obstacles(chains: Sequence[Chain], surface: NDArray[np.float64], spacing_m: float) -> Obstacles:
    """Return collision spheres along every chain, and at the measured points that belong to no chain.

    Args:
        chains: All chains of the scene.
        surface: (N, 3) measured points, metres, base frame, down-sampled to voxels.
        spacing_m: Edge length of the voxels, metres. The true surface is at most half a voxel diagonal from the nearest
            measured point.

    Returns:
        The obstacles, in the base frame.
    """
    lines = [_chain_spheres(chain) for chain in chains]
    points = np.vstack([np.empty((0, 3)), *(line for line, _ in lines)])
    count = np.array([len(line) for line, _ in lines], dtype=np.int64)
    radius = np.repeat(np.array([chain.radius_m for chain in chains], dtype=np.float64), count)
    number = np.repeat(np.array([chain.id for chain in chains], dtype=np.int64), count)
    s = np.concatenate([np.empty(0), *(s for _, s in lines)])
    objects = _object_points(surface, points, radius, spacing_m)
    sphere_radius = max(VOXEL_M, spacing_m) * np.sqrt(3) / 2
    return Obstacles(points, radius, number, s, _group_by_cell(objects, sphere_radius))


def _chain_spheres(chain: Chain) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (M, 3) along the chain, at most r / 2 apart, and their arc lengths (M,), metres.

    Spheres of radius r at these points cover the string, except for notches up to r / 30 deep.
    """
    line = close_polyline(chain.points, chain.closed)
    s = resampled_lengths(line, chain.radius_m / 2)
    return points_at(line, s), s


def _object_points(
    surface: NDArray[np.float64], strings: NDArray[np.float64], radius: NDArray[np.float64], spacing_m: float
) -> NDArray[np.float64]:
    """Return the object points (K, 3) of `surface` (N, 3), without strings, string noise and flying pixels.

    A dense surface is down-sampled to voxel centres. `strings` (M, 3) are points on the centre lines, and `radius` (M,)
    are the string radii at these points, metres.
    """
    gap = np.full(len(surface), np.inf)
    near_string = np.zeros(len(surface), dtype=bool)
    if len(strings) and len(surface):
        reach = radius + np.maximum(MAX_STRING_NOISE_M, radius)
        distance, indices = KDTree(strings).query(surface, distance_upper_bound=float(reach.max()))
        near = np.isfinite(distance)
        near_distance = np.asarray(distance)[near]
        nearest = np.asarray(indices)[near]
        gap[near] = near_distance - radius[nearest]
        near_string[near] = near_distance <= reach[nearest]
    uncertain = surface[near_string & (gap > MAX_STRING_NOISE_M)]
    surface = surface[~near_string]
    if len(surface) <= MIN_NEIGHBOURS:
        return np.empty((0, 3))
    max_distance = max(MIN_NEIGHBOUR_DISTANCE_M, NEIGHBOUR_SPACINGS * spacing_m)
    neighbours, _ = KDTree(surface).query(surface, k=MIN_NEIGHBOURS + 1, distance_upper_bound=max_distance)
    surface = surface[np.isfinite(np.asarray(neighbours)[:, -1])]
    # An object beside a thick string may continue into the noise zone of the string. Two steps of `max_distance` (at
    # least r) are enough to follow an upright wall from above through this zone.
    added = surface
    for _ in range(2):
        if len(added) and len(uncertain):
            distance, _ = KDTree(added).query(uncertain, distance_upper_bound=max_distance)
            joins = np.isfinite(distance)
            added = uncertain[joins]
            uncertain = uncertain[~joins]
            surface = np.vstack([surface, added])
    if spacing_m * MIN_THINNING_RATIO > VOXEL_M:
        return surface
    return voxel_centres(surface, VOXEL_M)


def _group_by_cell(points: NDArray[np.float64], radius_m: float) -> ObjectPoints:
    """Sort the sphere centres `points` (K, 3) by cell, and compute the centre and extent of each cell."""
    cell, count = voxel_indices(points, CELL_M)
    centre = group_sums(cell, points, len(count)) / count[:, None]
    extent = np.zeros(len(count))
    np.maximum.at(extent, cell, np.linalg.norm(points - centre[cell], axis=1))
    return ObjectPoints(points[np.argsort(cell, kind="stable")], radius_m, count.astype(np.int64), centre, extent)
