"""List of grasps to choose from: in clusters along the strings, with what lies near each grasp and how to carry it out.

Grasps in any order go in. The same grasps come out with ids, clusters, distances along the string and flange poses.
The best grasp of each cluster comes first in the list.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.grasping.candidates import finger_window
from recognition.grasping.flange_poses import LIFT_M, flange_poses
from recognition.grasping.gripper import Gripper
from recognition.grasping.obstacles import ObjectPoints, Obstacles
from recognition.model.chains import Chain, ChainInterpolator, Crossing, passes_below
from recognition.model.grasps import Grasp, GraspMotion, ScoredGrasp

CLUSTER_M = 0.02
"""Minimum distance along a chain between the best grasps of two clusters, metres."""
ABOVE_RADII = 0.5
"""Maximum distance of an object above a string from its centre line, seen from above, in string radii. Walls beside the
string are not above it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _DescribedGrasp(ScoredGrasp):
    """A grasp with its sigma, and with what lies near it along the string. The fields are those of `Grasp`."""

    sigma_m: float
    end_distance_m: float | None
    over_distance_m: float | None
    under_distance_m: float | None
    chains_above: tuple[int, ...]
    object_above_m: float | None


def list_grasps(
    grasps: Sequence[ScoredGrasp],
    chains: Sequence[Chain],
    crossings: Sequence[Crossing],
    obstacles: Obstacles,
    gripper: Gripper,
) -> tuple[Grasp, ...]:
    """Return the grasps with all their fields, in the order in which a planner may try them.

    First comes the best grasp of each cluster, and then all others. Within both parts, grasps with a doubt come last,
    and a higher score comes before a lower one.

    Args:
        grasps: Grasps on the chains.
        chains: Chains of the model.
        crossings: Crossings of the model.
        obstacles: Spheres of the objects of the scene.
        gripper: Gripper, for the flange poses.
    """
    if not grasps:
        return ()
    described: list[_DescribedGrasp] = []
    for chain in chains:
        on_chain = [grasp for grasp in grasps if grasp.chain == chain.id]
        if on_chain:
            described += _describe(on_chain, chain, crossings, obstacles.objects, gripper)
    ordered = sorted(described, key=_rank)
    by_id = {chain.id: ChainInterpolator(chain) for chain in chains}
    cluster = _clusters(ordered, by_id)
    poses = flange_poses(
        np.array([grasp.T_base_grasp for grasp in ordered]), [grasp.reach_m for grasp in ordered], gripper
    )
    # The first grasp of each cluster in this order is its best.
    _, best = np.unique(cluster, return_index=True)
    order = [*best, *np.setdiff1d(np.arange(len(ordered)), best)]
    return tuple(
        Grasp(
            **vars(ordered[k]),
            id=number,
            cluster=int(cluster[k]),
            T_base_flange=GraspMotion(poses.pregrasp[k], poses.grasp[k], poses.retreat[k]),
        )
        for number, k in enumerate(order)
    )


def _rank(grasp: ScoredGrasp) -> tuple[bool, float, int, float]:
    """Return the sort key of a grasp: without a doubt first, the best first."""
    return (not grasp.trusted, -grasp.score, grasp.chain, grasp.s_m)


def _clusters(ordered: Sequence[ScoredGrasp], by_id: dict[int, ChainInterpolator]) -> NDArray[np.int64]:
    """Return the cluster (N,) of each grasp, numbered in the order of the best grasp of each.

    In this order, a grasp joins the first cluster whose best grasp is within `CLUSTER_M` along the chain, or else it
    begins a cluster.

    Args:
        ordered: Grasps, the best first.
        by_id: Chains by their ids.
    """
    best: list[ScoredGrasp] = []
    cluster = np.empty(len(ordered), dtype=np.int64)
    for k, grasp in enumerate(ordered):
        numbers = [number for number, other in enumerate(best) if other.chain == grasp.chain]
        s = np.array([best[number].s_m for number in numbers])
        near = np.flatnonzero(by_id[grasp.chain].distance(s, grasp.s_m) < CLUSTER_M)
        if len(near):
            cluster[k] = numbers[near[0]]
        else:
            cluster[k] = len(best)
            best.append(grasp)
    return cluster


def _describe(
    grasps: Sequence[ScoredGrasp], chain: Chain, crossings: Sequence[Crossing], objects: ObjectPoints, gripper: Gripper
) -> list[_DescribedGrasp]:
    """Return grasps on one chain with their sigma, and with what lies near them along the string."""
    line = ChainInterpolator(chain)
    s = np.array([grasp.s_m for grasp in grasps])
    sigma = line(finger_window(s, gripper), chain.sigma_m).max(axis=1)
    to_end = np.full(len(s), np.inf)
    if not chain.closed:
        to_end = np.minimum(s, chain.length_m - s)
    to_over = line.nearest_distance(s, [x.over.s_m for x in crossings if x.over.chain == chain.id])
    to_under = line.nearest_distance(s, [x.under.s_m for x in crossings if x.under.chain == chain.id])
    chains_above = _chains_above(line, s, crossings)
    object_above = _object_above(line, s, objects)
    return [
        _DescribedGrasp(
            **vars(grasp),
            sigma_m=float(sigma[k]),
            end_distance_m=_finite(to_end[k]),
            over_distance_m=_finite(to_over[k]),
            under_distance_m=_finite(to_under[k]),
            chains_above=chains_above[k],
            object_above_m=_finite(object_above[k]),
        )
        for k, grasp in enumerate(grasps)
    ]


def _chains_above(
    line: ChainInterpolator, s: NDArray[np.float64], crossings: Sequence[Crossing]
) -> list[tuple[int, ...]]:
    """Return the ids of the chains over the string within the lift from each grasp (N,)."""
    above: list[set[int]] = [set() for _ in s]
    for below, other in passes_below(line.chain, crossings):
        for k in np.flatnonzero(line.distance(s, below.s_m) <= LIFT_M):
            above[k].add(other.chain)
    return [tuple(sorted(ids)) for ids in above]


def _object_above(line: ChainInterpolator, s: NDArray[np.float64], objects: ObjectPoints) -> NDArray[np.float64]:
    """Return the heights (N,) of the lowest object above the string near each grasp, from the grasp on; inf for none.

    The lift takes with it the string within `LIFT_M` along it. Objects that are beside the string, or higher than the
    lift, are not above it.
    """
    chain = line.chain
    found = np.full(len(s), np.inf)
    if len(objects.points) == 0:
        return found
    tree_xy = KDTree(chain.points[:, :2])
    near_m = ABOVE_RADII * chain.radius_m
    # Only the spheres of cells near the string are searched one by one.
    max_distance = float(objects.extent_m.max()) + near_m
    near = tree_xy.sparse_distance_matrix(objects.tree_xy, max_distance, output_type="ndarray")
    cells = np.unique(near["j"])
    if len(cells) == 0:
        return found
    spheres = objects.points[objects.spheres_of(cells)]
    near = tree_xy.sparse_distance_matrix(KDTree(spheres[:, :2]), near_m, output_type="ndarray")
    chain_point = near["i"]
    height = spheres[near["j"], 2]
    is_above = height > chain.points[chain_point, 2] + chain.radius_m
    if not is_above.any():
        return found
    string_s = chain.arc_length_m[chain_point[is_above]]
    rise = height[is_above] - line(s, chain.points)[:, 2, None]
    counts = (line.distance(string_s, s[:, None]) <= LIFT_M) & (rise <= LIFT_M)
    return np.where(counts, rise, np.inf).min(axis=1)


def _finite(value: float) -> float | None:
    """Return a number, or None for infinity."""
    return float(value) if np.isfinite(value) else None
