"""What a gripper can run into: every strand, seen or not, and whatever else was measured above the table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.model import Chain
from recognition.polyline import arc_length, closed_up, evenly

SURFACE_POINTS = 10_000
"""So many points of the surface are looked at: things are larger than their distance."""
NEAR_M = 0.004
"""A point nearer than this to a string's surface, or than the string's radius, is the string's own with noise."""
VOXEL_M = 0.0015
"""What is no string counts by voxels: a ball around each that holds a point."""
COMPANY_M = 0.004
"""Points of a thing have others this near; lone ones are flying pixels."""
COMPANY = 4
"""So many others."""


@dataclass(frozen=True, eq=False)
class Obstacles:
    """Balls that stand for everything above the table."""

    points: NDArray[np.float64]
    """(M, 3)."""
    radius_m: NDArray[np.float64]
    """(M,)."""
    chain: NDArray[np.int64]
    """(M,), id of the chain, -1 for what is no string."""
    s_m: NDArray[np.float64]
    """(M,), arc length along the chain."""


def gather_obstacles(chains: Sequence[Chain], surface: NDArray[np.float64]) -> Obstacles:
    """Balls along every chain, and those of the measured points `surface` (N, 3) that belong to no chain."""
    lines = [_balls(chain) for chain in chains]
    points = np.vstack([np.empty((0, 3)), *(line for line, _ in lines)])
    count = np.array([len(line) for line, _ in lines], dtype=np.int64)
    radius = np.repeat(np.array([chain.radius_m for chain in chains], dtype=np.float64), count)
    things = _things(surface[:: len(surface) // SURFACE_POINTS + 1], points, radius)
    number = np.repeat(np.array([chain.id for chain in chains], dtype=np.int64), count)
    return Obstacles(
        points=np.vstack([points, things]),
        radius_m=np.concatenate([radius, np.full(len(things), VOXEL_M * np.sqrt(3) / 2)]),
        chain=np.concatenate([number, np.full(len(things), -1)]),
        s_m=np.concatenate([*(s for _, s in lines), np.zeros(len(things))]),
    )


def _balls(chain: Chain) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of the chain at most r / 2 apart: balls of radius r about them fill the string but for r / 30."""
    balls = evenly(closed_up(chain.points, chain.closed), chain.radius_m / 2)
    return balls, arc_length(balls)


def _things(
    surface: NDArray[np.float64], strings: NDArray[np.float64], radius: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(K, 3) centres of the voxels with points of `surface` that lie beside all strings and are not alone."""
    if len(strings) and len(surface):
        reach = radius + np.maximum(NEAR_M, radius)
        found = KDTree(strings).query(surface, distance_upper_bound=float(reach.max()))
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        near = np.isfinite(distance)
        near[near] = distance[near] <= reach[nearest[near]]
        surface = surface[~near]
    if len(surface) <= COMPANY:
        return np.empty((0, 3))
    company, _ = KDTree(surface).query(surface, k=COMPANY + 1, distance_upper_bound=COMPANY_M)
    surface = surface[np.isfinite(np.asarray(company)[:, -1])]
    voxel = np.floor(surface / VOXEL_M)
    voxel = voxel[np.lexsort(voxel.T)]
    new = np.ones(len(voxel), dtype=bool)
    new[1:] = (np.diff(voxel, axis=0) != 0).any(axis=1)
    return (voxel[new] + 0.5) * VOXEL_M
