"""Obstacles for the gripper: every chain along its whole length, and the other objects above the table."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import close_polyline, points_at, resampled_lengths
from recognition.geometry.voxel_grid import voxel_indices
from recognition.model.chains import Chain

MAX_STRING_NOISE_M = 0.004
"""A point closer than this to the surface of a string is noise of the string, metres.

A point that is farther away, but closer than the radius of the string, is noise too unless an object is beside it.
"""
VOXEL_M = 0.0015
"""Edge of the voxels to which a fine surface is thinned, metres."""
MIN_THINNING_RATIO = 1.5
"""A surface is thinned if `VOXEL_M` is at least this multiple of its spacing.

The balls about the centres of the voxels then leave no holes in a plane.
"""
MIN_NEIGHBOUR_DISTANCE_M = 0.004
"""Neighbours of a point are within this distance, metres, or within `NEIGHBOUR_SPACINGS` if that is farther."""
NEIGHBOUR_SPACINGS = 3
"""Neighbours of a point are within this number of spacings of the surface."""
MIN_NEIGHBOURS = 4
"""A point with fewer neighbours is a flying pixel. A plane has 28 within three spacings, a thin rod 6."""
CELL_M = 0.01
"""Edge of the cells that group the points of objects, metres. Cells far from a gripper are skipped."""


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Balls of equal size that cover the measured objects, in the order of their cells."""

    points: NDArray[np.float64]
    """(K, 3) centres of the balls, metres, base frame."""
    radius_m: float
    """Radius of the balls, metres."""
    count: NDArray[np.int64]
    """(C,) number of balls in each cell; no cell is empty."""
    centre: NDArray[np.float64]
    """(C, 3) mean of the points of each cell, metres, base frame."""
    extent_m: NDArray[np.float64]
    """(C,) distance of each cell's farthest point from its centre, metres."""

    @cached_property
    def tree_xy(self) -> KDTree:
        """Search tree of the centres of the cells in the table plane."""
        return KDTree(self.centre[:, :2])


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Balls that cover every chain along its whole length, and all other objects measured above the table."""

    points: NDArray[np.float64]
    """(M, 3) centres of the balls of the chains, metres, base frame."""
    radius_m: NDArray[np.float64]
    """(M,) radius of each ball, metres."""
    chain: NDArray[np.int64]
    """(M,) id of the chain."""
    s_m: NDArray[np.float64]
    """(M,) arc length along the chain, metres."""
    objects: ObjectPoints
    """Objects that are not strings."""

    @cached_property
    def tree_xy(self) -> KDTree:
        """Search tree of the points of the chains in the table plane."""
        return KDTree(self.points[:, :2])


def gather_obstacles(chains: Sequence[Chain], surface: NDArray[np.float64], spacing_m: float) -> Obstacles:
    """Return balls along every chain, and balls over the measured points that belong to no chain.

    Args:
        chains: All chains of the scene.
        surface: (N, 3) measured points, metres, base frame, merged to voxels.
        spacing_m: Edge of those voxels, metres. A surface is at most half their diagonal away from its points.

    Returns:
        The obstacles, in the base frame.

    Source:
        Ours.
    """
    lines = [_chain_balls(chain) for chain in chains]
    points = np.vstack([np.empty((0, 3)), *(line for line, _ in lines)])
    count = np.array([len(line) for line, _ in lines], dtype=np.int64)
    radius = np.repeat(np.array([chain.radius_m for chain in chains], dtype=np.float64), count)
    number = np.repeat(np.array([chain.id for chain in chains], dtype=np.int64), count)
    s = np.concatenate([np.empty(0), *(s for _, s in lines)])
    objects = _object_points(surface, points, radius, spacing_m)
    ball_radius = max(VOXEL_M, spacing_m) * np.sqrt(3) / 2
    return Obstacles(points, radius, number, s, _group_by_cell(objects, ball_radius))


def _chain_balls(chain: Chain) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points of the chain at most r / 2 apart, and their arc lengths.

    Balls of radius r about these points leave notches in the surface of the string that are up to r / 30 deep.
    """
    line = close_polyline(chain.points, chain.closed)
    s = resampled_lengths(line, chain.radius_m / 2)
    return points_at(line, s), s


def _object_points(
    surface: NDArray[np.float64], strings: NDArray[np.float64], radius: NDArray[np.float64], spacing_m: float
) -> NDArray[np.float64]:
    """Return (K, 3) the points of `surface` that are no string and not isolated, or the centres of their voxels."""
    gap = np.full(len(surface), np.inf)
    near_string = np.zeros(len(surface), dtype=bool)
    if len(strings) and len(surface):
        reach = radius + np.maximum(MAX_STRING_NOISE_M, radius)
        found = KDTree(strings).query(surface, distance_upper_bound=float(reach.max()))
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        near = np.isfinite(distance)
        gap[near] = distance[near] - radius[nearest[near]]
        near_string[near] = distance[near] <= reach[nearest[near]]
    uncertain, surface = surface[near_string & (gap > MAX_STRING_NOISE_M)], surface[~near_string]
    if len(surface) <= MIN_NEIGHBOURS:
        return np.empty((0, 3))
    max_distance = max(MIN_NEIGHBOUR_DISTANCE_M, NEIGHBOUR_SPACINGS * spacing_m)
    neighbours, _ = KDTree(surface).query(surface, k=MIN_NEIGHBOURS + 1, distance_upper_bound=max_distance)
    surface = surface[np.isfinite(np.asarray(neighbours)[:, -1])]
    # An object beside a thick string continues into the zone of that string's noise. Two steps of `max_distance`, r
    # each, are enough to follow an upright wall through this zone from above.
    added = surface
    for _ in range(2):
        if len(added) and len(uncertain):
            distance, _ = KDTree(added).query(uncertain, distance_upper_bound=max_distance)
            joins = np.isfinite(distance)
            added, uncertain = uncertain[joins], uncertain[~joins]
            surface = np.vstack([surface, added])
    if spacing_m * MIN_THINNING_RATIO > VOXEL_M:
        return surface
    return (np.unique(np.floor(surface / VOXEL_M), axis=0) + 0.5) * VOXEL_M


def _group_by_cell(points: NDArray[np.float64], radius_m: float) -> ObjectPoints:
    """Return the points (K, 3) in the order of their cells, with the centre and extent of each cell."""
    cell, count = voxel_indices(points, CELL_M)
    centre = group_sums(cell, points, len(count)) / count[:, None]
    extent = np.zeros(len(count))
    np.maximum.at(extent, cell, np.linalg.norm(points - centre[cell], axis=1))
    return ObjectPoints(points[np.argsort(cell, kind="stable")], radius_m, count.astype(np.int64), centre, extent)
