"""Where a parallel gripper can take a string: candidates along each chain, with what they keep clear of.

The gripper comes straight down on the centre line and closes across the string. Where other strands or things are
near, it may also come tilted about the string, or reach less deep.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.grasping.candidates import FAR_M, ROUNDING_M, GraspCandidates, find_candidates
from recognition.grasping.gripper import Gripper, swept_distance
from recognition.grasping.obstacles import ObjectPoints, Obstacles, gather_obstacles
from recognition.model.interpolation import ChainInterpolator
from recognition.model.model import Chain, Crossing, Grasp
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.fusion import VOXEL_SHARE

ROOM_M = 0.01
"""Clearance that is as good as any."""
LEAST_REACH = 0.2
"""Share of the radius that the fingertips must at least reach beyond the centre line, or the string slips out."""
WAYS = ((0.0, 1.0), (0.0, 0.5), (15.0, 1.0), (-15.0, 1.0), (30.0, 1.0), (-30.0, 1.0))
"""Tilts about the string, degrees, and shares of the radius to reach beyond the centre line, in order of trial."""


def find_grasps(
    chains: Sequence[Chain],
    crossings: Sequence[Crossing],
    surface: NDArray[np.float64],
    scene: Scene,
    parameters: ChainParameters,
    gripper: Gripper,
) -> tuple[tuple[Grasp, ...], list[str]]:
    """Grasps along all chains, the best first, and in words why a chain has none.

    There is none

    - within half a finger's width of an end;
    - within that and r_cn, an intersection's extent, of a crossing where the chain is the strand underneath, or may
      be; on the strand above only where the gripper keeps clear of the one below;
    - where no view saw the string;
    - where it would need a wider opening than the gripper has: the string's diameter, two sigma to either side, its
      bend over a finger's width, and the gripper's margin;
    - where the fingertips, kept clear of the table, would not reach beyond the centre line;
    - where fingers or palm, drawn out against the approach, would come nearer than the gripper's clearance to
      another strand (or the same one come back), to a thing on the table, or to the string itself beside the
      fingers. Other strands and things also keep out of the room between the fingers.

    The score is a product of shares of what is as good as any: clearance of `ROOM_M`; views of `ENOUGH_VIEWS`;
    half a score at an end or crossing pass, a full one `FAR_M` from it; 1 / (1 + (2 sigma / r)^2); the cosines of
    the string's bend over half a finger's width, of its slope, and of the gripper's tilt; and half a score for
    fingertips that only just reach beyond the centre line, a full one at r.

    Args:
        surface: (N, 3) measured points higher than z_t above the table, of strings and anything else, merged to
            voxels of r * `VOXEL_SHARE`.
    """
    obstacles = gather_obstacles(chains, surface, VOXEL_SHARE * parameters.r)
    grasps: list[Grasp] = []
    warnings = []
    for chain in chains:
        places, reason = find_candidates(chain, crossings, parameters, gripper)
        found = _best(chain, places, obstacles, scene.table_z_m, gripper) if places is not None else []
        if not found:
            warnings.append(f"chain {chain.id} cannot be grasped: {reason}")
        grasps += found
    return tuple(sorted(grasps, key=lambda grasp: (-grasp.score, grasp.chain, grasp.s_m))), warnings


def _best(
    chain: Chain, places: GraspCandidates, obstacles: Obstacles, table_z_m: float, gripper: Gripper
) -> list[Grasp]:
    """The best way for each place that has one."""
    best: list[Grasp | None] = [None] * len(places.s_m)
    crowded = np.arange(len(places.s_m))
    for degrees, share in WAYS:
        if len(crowded) == 0:
            break
        tilt, at = np.radians(degrees), crowded
        T = _frames(places.point[at], places.along[at], tilt)
        opening = places.opening_m[at]
        # The lowest corner of a fingertip: its outer one when the gripper is tilted.
        corner = opening / 2 + gripper.finger_thickness_m
        height = places.point[at, 2] - table_z_m - abs(np.sin(tilt)) * corner
        room = (height - gripper.table_clearance_m) / np.cos(tilt)
        reach = np.minimum(share * chain.radius_m, room)
        clearance, touches = _from_strings(chain, places.s_m[at], T, opening, reach, obstacles, gripper)
        clearance = np.minimum(clearance, _from_things(T, opening, reach, obstacles.things, gripper))
        possible = (reach >= LEAST_REACH * chain.radius_m) & ~touches & (clearance >= gripper.clearance_m)
        held = 0.5 + 0.5 * np.clip(reach / chain.radius_m, 0, 1)
        score = places.merit[at] * np.clip(clearance / ROOM_M, 0, 1) * held * np.cos(tilt)
        for k in np.flatnonzero(possible):
            known = best[at[k]]
            if known is None or score[k] > known.score:
                above = float(height[k] - np.cos(tilt) * reach[k])
                best[at[k]] = Grasp(
                    chain.id, float(places.s_m[at[k]]), T[k], float(opening[k]), float(reach[k]),
                    float(clearance[k]), above, float(score[k]),
                )  # fmt: skip
        # Another way can only help where the way is narrow.
        crowded = at[touches | (clearance < ROOM_M)]
    return [grasp for grasp in best if grasp is not None]


def _from_strings(
    chain: Chain,
    s: NDArray[np.float64],
    T: NDArray[np.float64],
    opening: NDArray[np.float64],
    reach: NDArray[np.float64],
    strings: Obstacles,
    gripper: Gripper,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(N,) distances from strands not gripped, at most `FAR_M`, and (N,) whether the string itself is touched."""
    clearance, touches = np.full(len(s), FAR_M), np.zeros(len(s), dtype=bool)
    pose, ball = _near(T, strings.points, strings.from_above, float(strings.radius_m.max()), gripper)
    way, local = _seen_from(T, pose, strings.points[ball])
    own = strings.chain[ball] == chain.id
    along = ChainInterpolator(chain).apart(strings.s_m[ball], s[pose])
    # The gripped string counts with the others where it has come back.
    itself = own & (along <= 2 * np.linalg.norm(way, axis=1) + gripper.finger_width_m)
    distance = swept_distance(local, opening[pose], reach[pose], gripper, ~itself) - strings.radius_m[ball]
    np.minimum.at(clearance, pose[~itself], distance[~itself])
    # It was to pass between the fingers with half the margin to either side.
    kept = min(gripper.clearance_m, gripper.opening_margin_m / 2) - ROUNDING_M
    touches[pose[itself & (distance < kept)]] = True
    return clearance, touches


def _from_things(
    T: NDArray[np.float64],
    opening: NDArray[np.float64],
    reach: NDArray[np.float64],
    things: ObjectPoints,
    gripper: Gripper,
) -> NDArray[np.float64]:
    """(N,) distances from things, at most `FAR_M`; less than the gripper's clearance, but not exact, if too near.

    A cell of things is looked at ball by ball only where it may hold the nearest.
    """
    clearance, closing = np.full(len(T), FAR_M), np.ones(len(T), dtype=bool)
    if len(things.points) == 0:
        return clearance
    pose, cell = _near(T, things.centre, things.from_above, float(things.extent_m.max()) + things.radius_m, gripper)
    _, local = _seen_from(T, pose, things.centre[cell])
    to_centre = swept_distance(local, opening[pose], reach[pose], gripper, closing[pose]) - things.radius_m
    np.minimum.at(clearance, pose, to_centre + things.extent_m[cell])
    open_still = to_centre - things.extent_m[cell] < clearance[pose]
    open_still &= clearance[pose] >= gripper.clearance_m
    pose, cell = pose[open_still], cell[open_still]
    count = things.count[cell]
    first = np.cumsum(things.count) - things.count
    ball = np.arange(count.sum()) + np.repeat(first[cell] - (np.cumsum(count) - count), count)
    pose = np.repeat(pose, count)
    _, local = _seen_from(T, pose, things.points[ball])
    distance = swept_distance(local, opening[pose], reach[pose], gripper, closing[pose]) - things.radius_m
    np.minimum.at(clearance, pose, distance)
    return clearance


def _near(
    T: NDArray[np.float64], points: NDArray[np.float64], from_above: KDTree, extent_m: float, gripper: Gripper
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of a pose and of a point around which something of that extent may be nearer to it than `FAR_M`."""
    radius = FAR_M + extent_m
    radius += np.hypot(gripper.stroke_m / 2 + gripper.finger_thickness_m, gripper.palm_width_m / 2)
    # A tilted gripper meets high things beside its place.
    higher = float(np.ptp(np.append(points[:, 2], T[:, 2, 3])))
    radius += higher * float(np.abs(T[:, 2, 0] / T[:, 2, 2]).max())
    near = KDTree(T[:, :2, 3]).sparse_distance_matrix(from_above, radius, output_type="ndarray")
    return near["i"], near["j"]


def _seen_from(
    T: NDArray[np.float64], pose: NDArray[np.intp], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(K, 3) ways from the poses numbered `pose` (K,) to the points (K, 3), in the base frame and in the pose's."""
    way = points - T[pose, :3, 3]
    return way, np.einsum("ni,nij->nj", way, T[pose, :3, :3])


def _frames(point: NDArray[np.float64], along: NDArray[np.float64], tilt: float) -> NDArray[np.float64]:
    """(N, 4, 4) T_base_grasp: y along the string, z down and turned by `tilt` about y."""
    down = np.broadcast_to((0.0, 0.0, -1.0), along.shape)
    left = np.cross(along, down)
    T = np.zeros((len(point), 4, 4))
    T[:, :3, 0] = np.cos(tilt) * left - np.sin(tilt) * down
    T[:, :3, 1] = along
    T[:, :3, 2] = np.cos(tilt) * down + np.sin(tilt) * left
    T[:, :3, 3] = point
    T[:, 3, 3] = 1.0
    return T
