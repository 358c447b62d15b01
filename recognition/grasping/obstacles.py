"""What a gripper can run into: every strand, seen or not, and whatever else was measured above the table."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.neighbours import group_sums
from recognition.geometry.polyline import close_polyline, points_at, resampled_lengths
from recognition.geometry.voxel_grid import voxel_indices
from recognition.model.model import Chain

NEAR_M = 0.004
"""A point nearer than this to a string's surface is the string's own with noise; farther away but nearer than the
string's radius, it is so unless a thing is beside it."""
VOXEL_M = 0.0015
"""A surface that is much finer than this is thinned to voxels of this edge ..."""
MUCH_FINER = 1.5
"""... that is, by this factor: then the balls about the voxels' centres leave no holes in a plane."""
COMPANY_M = 0.004
"""Points of a thing have others this near ..."""
COMPANY_SPACINGS = 3
"""... or within so many spacings of the surface; lone ones are flying pixels."""
COMPANY = 4
"""So many others: a plane has 28 within three spacings, a thin rod 6."""
CELL_M = 0.01
"""Edge of the cells by which things far from a gripper are passed over."""


@dataclass(frozen=True, eq=False)
class ObjectPoints:
    """Balls of one size that cover what was measured and is no string, in the order of the cells they lie in."""

    points: NDArray[np.float64]
    """(K, 3)."""
    radius_m: float
    count: NDArray[np.int64]
    """(C,), balls in each cell; none is empty."""
    centre: NDArray[np.float64]
    """(C, 3), mean of each cell's points."""
    extent_m: NDArray[np.float64]
    """(C,), how far the farthest of a cell's points lies from its centre."""

    @cached_property
    def from_above(self) -> KDTree:
        """Of the cells' centres in the table plane."""
        return KDTree(self.centre[:, :2])


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Balls that stand for everything measured above the table, and for every chain all along."""

    points: NDArray[np.float64]
    """(M, 3), of the chains."""
    radius_m: NDArray[np.float64]
    """(M,)."""
    chain: NDArray[np.int64]
    """(M,), id of the chain."""
    s_m: NDArray[np.float64]
    """(M,), arc length along the chain."""
    things: ObjectPoints

    @cached_property
    def from_above(self) -> KDTree:
        """Of the points in the table plane."""
        return KDTree(self.points[:, :2])


def gather_obstacles(chains: Sequence[Chain], surface: NDArray[np.float64], spacing_m: float) -> Obstacles:
    """Balls along every chain, and over the measured points that belong to no chain.

    Args:
        surface: (N, 3) measured points, thinned to voxels.
        spacing_m: edge of those voxels. Half their diagonal is how far a surface's places lie from its points.
    """
    lines = [_balls(chain) for chain in chains]
    points = np.vstack([np.empty((0, 3)), *(line for line, _ in lines)])
    count = np.array([len(line) for line, _ in lines], dtype=np.int64)
    radius = np.repeat(np.array([chain.radius_m for chain in chains], dtype=np.float64), count)
    number = np.repeat(np.array([chain.id for chain in chains], dtype=np.int64), count)
    s = np.concatenate([np.empty(0), *(s for _, s in lines)])
    things = _thing_points(surface, points, radius, spacing_m)
    return Obstacles(points, radius, number, s, _things(things, max(VOXEL_M, spacing_m) * np.sqrt(3) / 2))


def _balls(chain: Chain) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of the chain at most r / 2 apart, and their arc lengths: balls of radius r fill it but for r / 30."""
    line = close_polyline(chain.points, chain.closed)
    s = resampled_lengths(line, chain.radius_m / 2)
    return points_at(line, s), s


def _thing_points(
    surface: NDArray[np.float64], strings: NDArray[np.float64], radius: NDArray[np.float64], spacing_m: float
) -> NDArray[np.float64]:
    """(K, 3) points of `surface` that lie beside all strings and are not alone, or the centres of their voxels."""
    beside = np.full(len(surface), np.inf)
    doubtful = np.zeros(len(surface), dtype=bool)
    if len(strings) and len(surface):
        reach = radius + np.maximum(NEAR_M, radius)
        found = KDTree(strings).query(surface, distance_upper_bound=float(reach.max()))
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        near = np.isfinite(distance)
        beside[near] = distance[near] - radius[nearest[near]]
        doubtful[near] = distance[near] <= reach[nearest[near]]
    doubted, surface = surface[doubtful & (beside > NEAR_M)], surface[~doubtful]
    if len(surface) <= COMPANY:
        return np.empty((0, 3))
    within = max(COMPANY_M, COMPANY_SPACINGS * spacing_m)
    company, _ = KDTree(surface).query(surface, k=COMPANY + 1, distance_upper_bound=within)
    surface = surface[np.isfinite(np.asarray(company)[:, -1])]
    # A thing that comes near a thick string does not end where that string's noise may begin: two steps of company's
    # reach, r each, are enough to follow an upright wall through it from above.
    new = surface
    for _ in range(2):
        if len(new) and len(doubted):
            way, _ = KDTree(new).query(doubted, distance_upper_bound=within)
            joins = np.isfinite(way)
            new, doubted = doubted[joins], doubted[~joins]
            surface = np.vstack([surface, new])
    if spacing_m * MUCH_FINER > VOXEL_M:
        return surface
    return (np.unique(np.floor(surface / VOXEL_M), axis=0) + 0.5) * VOXEL_M


def _things(points: NDArray[np.float64], radius_m: float) -> ObjectPoints:
    cell, count = voxel_indices(points, CELL_M)
    centre = group_sums(cell, points, len(count)) / count[:, None]
    extent = np.zeros(len(count))
    np.maximum.at(extent, cell, np.linalg.norm(points - centre[cell], axis=1))
    return ObjectPoints(points[np.argsort(cell, kind="stable")], radius_m, count.astype(np.int64), centre, extent)
