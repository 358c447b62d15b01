"""Grasp planner: grasps of a parallel gripper along each chain, with their clearance and score.

The gripper approaches the centre line from straight above and closes across the string. Near other strands or objects
it may also be tilted about the string, or reach less deep.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.grasping.candidates import MAX_RELEVANT_DISTANCE_M, ROUNDING_M, GraspCandidates, find_candidates
from recognition.grasping.gripper import Gripper, swept_distance
from recognition.grasping.obstacles import ObjectPoints, Obstacles, gather_obstacles
from recognition.model.chains import Chain, ChainInterpolator, Crossing, Grasp
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.fusion import VOXEL_RADII

FULL_SCORE_CLEARANCE_M = 0.01
"""Clearance, metres, from which a grasp gets the full score for clearance."""
MIN_REACH_SHARE = 0.2
"""Minimum reach of the fingertips beyond the centre line, as a share of the radius: with less, the string slips out."""
APPROACH_OPTIONS = ((0.0, 1.0), (0.0, 0.5), (15.0, 1.0), (-15.0, 1.0), (30.0, 1.0), (-30.0, 1.0))
"""Tilt about the string, degrees, and reach beyond the centre line, as a share of the radius, in the order of trial."""


def find_grasps(
    chains: Sequence[Chain],
    crossings: Sequence[Crossing],
    surface: NDArray[np.float64],
    scene: Scene,
    parameters: ChainParameters,
    gripper: Gripper,
) -> tuple[tuple[Grasp, ...], list[str]]:
    """Return grasps along all chains, the best first, and a warning for each chain without a grasp.

    A position has no grasp

    - within half the width of a finger from an end;
    - within that distance plus r_cn, the extent of an intersection, from a crossing where the chain is the lower
      strand, or may be it. On the upper strand, the gripper must keep clear of the lower one;
    - if no view saw the string there;
    - if the needed opening exceeds the stroke of the gripper. The opening is the diameter of the string, two sigma to
      either side, the bend over the width of a finger, and the margin of the gripper;
    - if the fingertips, kept clear of the table, do not reach far enough beyond the centre line;
    - if fingers or palm, extended against the approach, come closer than the clearance of the gripper to another
      strand, to another part of the same strand, to an object, or to the string itself beside the fingers. Other
      strands and objects must not be in the space between the fingers either.

    The score is a product of factors:

    - clearance: 1 from `FULL_SCORE_CLEARANCE_M` on;
    - views: 1 from `FULL_SCORE_VIEWS` on;
    - distance from the nearest end or crossing pass: from 0.5 at the pass to 1 at `MAX_RELEVANT_DISTANCE_M`;
    - sigma: 1 / (1 + (2 sigma / r)^2);
    - the cosines of the bend over half the width of a finger, of the slope of the string, and of the tilt;
    - reach of the fingertips beyond the centre line: from 0.5 at none to 1 at r.

    Args:
        chains: Chains of the model.
        crossings: Crossings of the chains.
        surface: (N, 3) measured points higher than z_t above the table, of strings and of other objects, metres, base
            frame, merged to voxels of r * `VOXEL_RADII`.
        scene: Height of the table.
        parameters: Radius r and extent r_cn of an intersection.
        gripper: Dimensions of the gripper.

    Returns:
        The grasps in the base frame, and the warnings.

    Source:
        Ours.
    """
    obstacles = gather_obstacles(chains, surface, VOXEL_RADII * parameters.r)
    grasps: list[Grasp] = []
    warnings = []
    for chain in chains:
        candidates, reason = find_candidates(chain, crossings, parameters, gripper)
        found = [] if candidates is None else _best_grasps(chain, candidates, obstacles, scene.table_z_m, gripper)
        if not found:
            warnings.append(f"chain {chain.id} cannot be grasped: {reason}")
        grasps += found
    return tuple(sorted(grasps, key=lambda grasp: (-grasp.score, grasp.chain, grasp.s_m))), warnings


def _best_grasps(
    chain: Chain, candidates: GraspCandidates, obstacles: Obstacles, table_z_m: float, gripper: Gripper
) -> list[Grasp]:
    """Return the grasp with the best approach option for each candidate that has one."""
    best: list[Grasp | None] = [None] * len(candidates.s_m)
    crowded = np.arange(len(candidates.s_m))
    for degrees, share in APPROACH_OPTIONS:
        if len(crowded) == 0:
            break
        tilt, at = np.radians(degrees), crowded
        T = _grasp_frames(candidates.point[at], candidates.direction[at], tilt)
        opening = candidates.opening_m[at]
        # The lowest corner of a fingertip is the outer one if the gripper is tilted.
        corner = opening / 2 + gripper.finger_thickness_m
        height = candidates.point[at, 2] - table_z_m - abs(np.sin(tilt)) * corner
        max_reach = (height - gripper.table_clearance_m) / np.cos(tilt)
        reach = np.minimum(share * chain.radius_m, max_reach)
        clearance, touches = _clearance_from_strings(chain, candidates.s_m[at], T, opening, reach, obstacles, gripper)
        clearance = np.minimum(clearance, _clearance_from_objects(T, opening, reach, obstacles.objects, gripper))
        possible = (reach >= MIN_REACH_SHARE * chain.radius_m) & ~touches & (clearance >= gripper.clearance_m)
        reach_score = 0.5 + 0.5 * np.clip(reach / chain.radius_m, 0, 1)
        clearance_score = np.clip(clearance / FULL_SCORE_CLEARANCE_M, 0, 1)
        score = candidates.base_score[at] * clearance_score * reach_score * np.cos(tilt)
        for k in np.flatnonzero(possible):
            known = best[at[k]]
            if known is None or score[k] > known.score:
                above = float(height[k] - np.cos(tilt) * reach[k])
                best[at[k]] = Grasp(
                    chain.id, float(candidates.s_m[at[k]]), T[k], float(opening[k]), float(reach[k]),
                    float(clearance[k]), above, float(score[k]),
                )  # fmt: skip
        # Another option can only improve candidates that do not have the full clearance.
        crowded = at[touches | (clearance < FULL_SCORE_CLEARANCE_M)]
    return [grasp for grasp in best if grasp is not None]


def _clearance_from_strings(
    chain: Chain,
    s: NDArray[np.float64],
    T: NDArray[np.float64],
    opening: NDArray[np.float64],
    reach: NDArray[np.float64],
    obstacles: Obstacles,
    gripper: Gripper,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (N,) clearances from strands that are not gripped, and (N,) whether the gripped string is touched.

    Clearances are at most `MAX_RELEVANT_DISTANCE_M`.
    """
    clearance, touches = np.full(len(s), MAX_RELEVANT_DISTANCE_M), np.zeros(len(s), dtype=bool)
    pose, ball = _near_pairs(T, obstacles.points, obstacles.tree_xy, float(obstacles.radius_m.max()), gripper)
    offset, local = _offsets(T, pose, obstacles.points[ball])
    same_chain = obstacles.chain[ball] == chain.id
    along = ChainInterpolator(chain).distance(obstacles.s_m[ball], s[pose])
    # A part of the gripped string that comes back to the grasp counts as another strand.
    gripped = same_chain & (along <= 2 * np.linalg.norm(offset, axis=1) + gripper.finger_width_m)
    distance = swept_distance(local, opening[pose], reach[pose], gripper, ~gripped) - obstacles.radius_m[ball]
    np.minimum.at(clearance, pose[~gripped], distance[~gripped])
    # The gripped string must pass between the fingers with half the margin to either side.
    min_distance = min(gripper.clearance_m, gripper.opening_margin_m / 2) - ROUNDING_M
    touches[pose[gripped & (distance < min_distance)]] = True
    return clearance, touches


def _clearance_from_objects(
    T: NDArray[np.float64],
    opening: NDArray[np.float64],
    reach: NDArray[np.float64],
    objects: ObjectPoints,
    gripper: Gripper,
) -> NDArray[np.float64]:
    """Return (N,) clearances from objects, at most `MAX_RELEVANT_DISTANCE_M`.

    Values below the clearance of the gripper are not exact. The balls of a cell are only checked if the cell may
    contain the nearest one.
    """
    clearance, closing = np.full(len(T), MAX_RELEVANT_DISTANCE_M), np.ones(len(T), dtype=bool)
    if len(objects.points) == 0:
        return clearance
    max_extent = float(objects.extent_m.max()) + objects.radius_m
    pose, cell = _near_pairs(T, objects.centre, objects.tree_xy, max_extent, gripper)
    _, local = _offsets(T, pose, objects.centre[cell])
    to_centre = swept_distance(local, opening[pose], reach[pose], gripper, closing[pose]) - objects.radius_m
    np.minimum.at(clearance, pose, to_centre + objects.extent_m[cell])
    unresolved = to_centre - objects.extent_m[cell] < clearance[pose]
    unresolved &= clearance[pose] >= gripper.clearance_m
    pose, cell = pose[unresolved], cell[unresolved]
    count = objects.count[cell]
    first = np.cumsum(objects.count) - objects.count
    ball = np.arange(count.sum()) + np.repeat(first[cell] - (np.cumsum(count) - count), count)
    pose = np.repeat(pose, count)
    _, local = _offsets(T, pose, objects.points[ball])
    distance = swept_distance(local, opening[pose], reach[pose], gripper, closing[pose]) - objects.radius_m
    np.minimum.at(clearance, pose, distance)
    return clearance


def _near_pairs(
    T: NDArray[np.float64], points: NDArray[np.float64], tree_xy: KDTree, extent_m: float, gripper: Gripper
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return pairs of a pose and a point that may be closer than `MAX_RELEVANT_DISTANCE_M`.

    `extent_m` is the maximum extent of the obstacle about a point.
    """
    radius = MAX_RELEVANT_DISTANCE_M + extent_m
    radius += np.hypot(gripper.stroke_m / 2 + gripper.finger_thickness_m, gripper.palm_width_m / 2)
    # A tilted gripper may touch a high object beside the grasp position.
    height_range = float(np.ptp(np.append(points[:, 2], T[:, 2, 3])))
    radius += height_range * float(np.abs(T[:, 2, 0] / T[:, 2, 2]).max())
    near = KDTree(T[:, :2, 3]).sparse_distance_matrix(tree_xy, radius, output_type="ndarray")
    return near["i"], near["j"]


def _offsets(
    T: NDArray[np.float64], pose: NDArray[np.intp], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (K, 3) the offsets of the points from the poses with the indices `pose`, in the base and grasp frames."""
    offset = points - T[pose, :3, 3]
    return offset, np.einsum("ni,nij->nj", offset, T[pose, :3, :3])


def _grasp_frames(point: NDArray[np.float64], direction: NDArray[np.float64], tilt: float) -> NDArray[np.float64]:
    """Return (N, 4, 4) T_base_grasp: y along the string, z down and tilted by `tilt` about y."""
    down = np.broadcast_to((0.0, 0.0, -1.0), direction.shape)
    left = np.cross(direction, down)
    T = np.zeros((len(point), 4, 4))
    T[:, :3, 0] = np.cos(tilt) * left - np.sin(tilt) * down
    T[:, :3, 1] = direction
    T[:, :3, 2] = np.cos(tilt) * down + np.sin(tilt) * left
    T[:, :3, 3] = point
    T[:, 3, 3] = 1.0
    return T
