"""Grasp planner: grasps of a parallel gripper along each chain, with their clearance and score.

The gripper approaches the centre line from straight above and closes across the string. Near other strands or objects,
the gripper may also reach less deep or open less wide. Only where no upright grasp is possible, it is tilted about the
string.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.grasping.candidates import (
    MAX_RELEVANT_DISTANCE_M,
    ROUNDING_M,
    GraspCandidates,
    find_candidates,
    half_to_one,
)
from recognition.grasping.gripper import Gripper, swept_distance
from recognition.grasping.local_floor import LocalFloor, low_object_findings
from recognition.grasping.obstacles import ObjectPoints, Obstacles
from recognition.model.chains import Chain, ChainInterpolator, Crossing
from recognition.model.findings import Finding, finding
from recognition.model.grasps import ScoredGrasp
from recognition.parameters import ChainParameters
from recognition.preprocessing.height_map import CELL_M

FULL_SCORE_CLEARANCE_M = 0.003
"""Minimum clearance for the full clearance score, metres. An arm with a hand-eye calibration is more accurate."""
FULL_SCORE_REACH_SHARE = 0.5
"""Minimum reach of the fingertips beyond the centre line for the full reach score, in string radii."""
MIN_REACH_SHARE = 0.45
"""Minimum reach of the fingertips beyond the centre line, in string radii. With less reach, the string slips out."""


@dataclass(frozen=True)
class Approach:
    """One way to approach a position."""

    tilt_rad: float = 0.0
    """Tilt of the gripper about the string, radians."""
    reach_share: float = 1.0
    """Maximum reach of the fingertips beyond the centre line, in string radii."""
    margin_share: float = 1.0
    """Share of the opening margin that is used."""


UPRIGHT = (Approach(), Approach(reach_share=0.5), Approach(margin_share=0.5), Approach(0.0, 0.5, 0.5))
"""Upright approaches, in the order of trial."""
TILTED = tuple(Approach(float(np.radians(degrees))) for degrees in (15.0, -15.0, 30.0, -30.0))
"""Tilted approaches for positions where no upright grasp is possible."""
TILTED_SWEEP_M = 0.01
"""Length of a tilted finger from its tip, metres, under which the floor must be free. Higher objects are measured."""


@dataclass(frozen=True)
class GraspSet:
    """Grasps on the chains of a scene, and the notes on chains without grasps."""

    grasps: tuple[ScoredGrasp, ...]
    """Grasps on all chains, the best first."""
    findings: tuple[Finding, ...]
    """One note on each chain without a grasp, and one if low objects are hidden in the noise."""


@dataclass(frozen=True, eq=False)
class _Trials:
    """N grasps of one chain by one approach, to be checked for collisions."""

    s_m: NDArray[np.float64]
    """(N,) arc length along the chain, metres."""
    T: NDArray[np.float64]
    """(N, 4, 4) grasp poses `T_base_grasp`."""
    opening_m: NDArray[np.float64]
    """(N,) opening between the fingers, metres."""
    reach_m: NDArray[np.float64]
    """(N,) distance of the fingertips beyond the centre line, metres."""
    gripper: Gripper
    """Dimensions of the gripper."""

    def offsets(self, number: NDArray[np.intp], points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the offsets (K, 3) of `points` (K, 3) from the origins of the grasps `number` (K,), base frame."""
        return points - self.T[number, :3, 3]

    def distances(
        self, number: NDArray[np.intp], offset: NDArray[np.float64], closing: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Return the distances (K,) of points from the volume that the gripper sweeps, metres.

        Args:
            number: (K,) grasp of each point.
            offset: (K, 3) offset of each point from the origin of its grasp, base frame, metres.
            closing: Mask (K,), True where the space between the fingers belongs to the volume; None for everywhere.
        """
        if closing is None:
            closing = np.ones(len(number), dtype=bool)
        x, y, z = offset.T
        R = self.T[:, :3, :3]
        # by components, which is three times as fast as one product of matrices for each pair
        local = [x * R[number, 0, j] + y * R[number, 1, j] + z * R[number, 2, j] for j in range(3)]
        return swept_distance(
            np.column_stack(local), self.opening_m[number], self.reach_m[number], self.gripper, closing
        )


@dataclass(frozen=True, eq=False)
class _Surroundings:
    """What the gripper must keep clear of."""

    obstacles: Obstacles
    """Spheres on all chains, and on all other objects above z_t."""
    floor: LocalFloor
    """Height of the table and of low objects on it."""
    edges: NDArray[np.float64]
    """(K, 3) edge cells of the low objects, metres, base frame."""


def find_grasps(
    chains: Sequence[Chain],
    crossings: Sequence[Crossing],
    obstacles: Obstacles,
    floor: LocalFloor,
    parameters: ChainParameters,
    gripper: Gripper,
) -> GraspSet:
    """Return grasps along all chains, the best first, and a note on each chain without a grasp.

    A position along a chain is rejected for any of these reasons:

    - The position is less than half a finger width from an end of the chain.
    - The position is near a crossing where the chain is, or may be, the lower strand. The limit is half a finger width
      plus r_cn, the extent of an intersection. Near other crossings, only the clearance counts.
    - At some point under the finger, no view saw the string.
    - The slope of the string exceeds 60 degrees.
    - The needed opening exceeds the stroke of the gripper. The opening is the string diameter, plus two sigma and the
      bend over a finger width on each side, plus the opening margin.
    - Fingertips that keep `Gripper.min_table_clearance_m` from the floor under them reach less than `MIN_REACH_SHARE`
      radii beyond the centre line. The floor is the table, or an object on it.
    - No view measured the floor under a fingertip.
    - On the approach, a finger or the palm comes closer than `Gripper.clearance_m` to an object, to another strand, or
      to a distant part of the same chain. An object or another strand between the fingers is not allowed either. An
      object that is lower than the fingertips is floor.
    - On the approach, a finger or the palm comes too close to the gripped string. The limit is `Gripper.clearance_m` or
      half of the margin in the opening, whichever is smaller.

    The score is the product of these factors:

    - clearance: proportional up to `FULL_SCORE_CLEARANCE_M`, then 1;
    - number of views: proportional up to `FULL_SCORE_VIEWS`, then 1;
    - distance from the nearest end or crossing pass: from 0.5 at zero to 1 at `MAX_RELEVANT_DISTANCE_M`;
    - sigma: 1 / (1 + (2 sigma / r)^2);
    - cosine of the bend of the string, cosine of its slope, and cosine of the gripper tilt;
    - reach of the fingertips beyond the centre line: from 0.5 at zero to 1 at `FULL_SCORE_REACH_SHARE` radii;
    - distance of the fingertips from the floor: from 0.5 at zero to 1 at `Gripper.table_clearance_m`;
    - opening: 1 with the whole opening margin, 0.9 with half of it.

    Args:
        chains: Chains of the model.
        crossings: Crossings of the chains.
        obstacles: Spheres that cover the chains and all other objects above z_t.
        floor: Height of the table and of low objects on it.
        parameters: Method parameters; uses the radius r and the extent r_cn of an intersection.
        gripper: Dimensions of the gripper.

    Returns:
        The grasps in the base frame, and the notes.
    """
    surroundings = _Surroundings(obstacles, floor, floor.edge_points())
    grasps: list[ScoredGrasp] = []
    findings: list[Finding] = []
    if chains:
        findings += low_object_findings(floor)
    for chain in chains:
        candidates, reason = find_candidates(chain, crossings, parameters, gripper)
        found: list[ScoredGrasp] = []
        if candidates is not None:
            found = _best_grasps(chain, candidates, surroundings, gripper)
        if not found:
            message = f"chain {chain.id} cannot be grasped: {reason}"
            findings.append(finding("no-grasp", message, chains=(chain.id,)))
        grasps += found
    grasps.sort(key=lambda grasp: (-grasp.score, grasp.chain, grasp.s_m))
    return GraspSet(tuple(grasps), tuple(findings))


def _best_grasps(
    chain: Chain,
    candidates: GraspCandidates,
    surroundings: _Surroundings,
    gripper: Gripper,
) -> list[ScoredGrasp]:
    """Return the best grasp of each candidate over all approaches. Omit candidates without a possible grasp."""
    best: list[ScoredGrasp | None] = [None] * len(candidates.s_m)
    for approaches in (UPRIGHT, TILTED):
        remaining = [k for k, grasp in enumerate(best) if grasp is None]
        for approach in approaches:
            if not remaining:
                break
            selected = candidates.select(np.array(remaining, dtype=np.int64))
            grasps = _try_approach(chain, selected, approach, surroundings, gripper)
            tried = list(zip(remaining, grasps, strict=True))
            for k, grasp in tried:
                known = best[k]
                if grasp is not None and (known is None or grasp.score > known.score):
                    best[k] = grasp
            # Other approaches can only improve candidates without the full clearance score.
            remaining = [k for k, grasp in tried if grasp is None or grasp.clearance_m < FULL_SCORE_CLEARANCE_M]
    return [grasp for grasp in best if grasp is not None]


def _try_approach(
    chain: Chain,
    candidates: GraspCandidates,
    approach: Approach,
    surroundings: _Surroundings,
    gripper: Gripper,
) -> list[ScoredGrasp | None]:
    """Return the grasp of each candidate by one approach, or None where it is not possible."""
    r = chain.radius_m
    tilt = approach.tilt_rad
    floor = surroundings.floor
    T = _grasp_frames(candidates.point, candidates.direction, tilt)
    margin = approach.margin_share * gripper.opening_margin_m
    opening = candidates.opening_m - gripper.opening_margin_m + margin

    floor_z = floor.highest(_fingertip_positions(T, opening, approach, r, gripper))
    # If the gripper is tilted, the outer corner of a fingertip is its lowest point.
    height = candidates.point[:, 2] - floor_z - abs(np.sin(tilt)) * (opening / 2 + gripper.finger_thickness_m)
    wanted_above = max(gripper.table_clearance_m, floor.min_height_m)
    wanted_reach = np.minimum((height - wanted_above) / np.cos(tilt), approach.reach_share * r)
    reach = np.where(np.isfinite(wanted_reach), np.maximum(wanted_reach, MIN_REACH_SHARE * r), 0.0)
    above = height - np.cos(tilt) * reach
    min_above = min(gripper.min_table_clearance_m, gripper.table_clearance_m)

    trials = _Trials(candidates.s_m, T, opening, reach, gripper)
    min_string_distance = min(gripper.clearance_m, margin / 2)
    clearance, touches = _clearance_from_strings(trials, chain, surroundings.obstacles, min_string_distance)
    clearance = np.minimum(clearance, _clearance_from_objects(trials, surroundings.obstacles.objects))
    clearance = np.minimum(clearance, _clearance_from_edges(trials, surroundings.edges, floor.cell_m / 2))
    possible = (above >= min_above - ROUNDING_M) & ~touches & (clearance >= gripper.clearance_m)

    # The factors are those of `find_grasps`.
    score = candidates.base_score * np.cos(tilt) * (0.8 + 0.2 * approach.margin_share)
    score *= np.clip(clearance / FULL_SCORE_CLEARANCE_M, 0, 1)
    score *= half_to_one(reach / (FULL_SCORE_REACH_SHARE * r))
    score *= half_to_one(above / max(gripper.table_clearance_m, ROUNDING_M))
    score = np.minimum(score, 1.0)  # rounding
    grasps: list[ScoredGrasp | None] = [None] * len(T)
    for k in np.flatnonzero(possible):
        grasps[k] = ScoredGrasp(
            chain=chain.id,
            s_m=float(candidates.s_m[k]),
            T_base_grasp=T[k],
            opening_m=float(opening[k]),
            reach_m=float(reach[k]),
            clearance_m=float(clearance[k]),
            table_clearance_m=float(above[k]),
            score=float(score[k]),
        )
    return grasps


def _fingertip_positions(
    T: NDArray[np.float64], opening: NDArray[np.float64], approach: Approach, radius_m: float, gripper: Gripper
) -> NDArray[np.float64]:
    """Return positions (N, K, 2) that the fingertips cover until they are closed, seen from above, metres.

    The positions include a clearance around the fingertips. Of tilted fingers, the ends are covered too.

    Args:
        T: (N, 4, 4) grasp poses `T_base_grasp`.
        opening: (N,) openings between the fingers, metres.
        approach: Approach with the largest reach of the fingertips.
        radius_m: Radius of the string, at which the fingers are closed, metres.
        gripper: Dimensions of the gripper.
    """
    outer = opening / 2 + gripper.finger_thickness_m + gripper.clearance_m
    half = gripper.finger_width_m / 2 + gripper.clearance_m
    across = np.linspace(0.0, 1.0, _count_cells(outer.max(initial=radius_m) - radius_m) + 1)
    along = np.linspace(-half, half, _count_cells(2 * half) + 1)
    back = np.zeros(1)
    if approach.tilt_rad != 0.0:
        back = np.linspace(0.0, TILTED_SWEEP_M, _count_cells(TILTED_SWEEP_M) + 1)
    # All combinations of a finger, a share of its way, and a position along and above its end.
    side, across, along, back = (a.ravel() for a in np.meshgrid((-1.0, 1.0), across, along, back, indexing="ij"))
    x = side * (radius_m + (outer[:, None] - radius_m) * across)
    y = np.broadcast_to(along, x.shape)
    z = np.broadcast_to(approach.reach_share * radius_m - back, x.shape)
    local = np.stack([x, y, z], axis=-1)
    return np.einsum("nij,nkj->nki", T[:, :2, :3], local) + T[:, None, :2, 3]


def _count_cells(length_m: float) -> int:
    """Return the number of cells of the height map that cover a length."""
    return int(np.ceil(length_m / CELL_M))


def _clearance_from_strings(
    trials: _Trials, chain: Chain, obstacles: Obstacles, min_string_distance_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the clearances (N,) from other strands, metres, and the mask (N,) of grasps that touch their own string.

    Clearances are at most `MAX_RELEVANT_DISTANCE_M`.

    Args:
        trials: Grasps to check.
        chain: The gripped chain.
        obstacles: Chains and objects of the scene; uses the chains.
        min_string_distance_m: Minimum distance of the gripper from the gripped string during the approach, metres.
    """
    number, sphere = _near_pairs(trials, obstacles.points, obstacles.tree_xy, float(obstacles.radius_m.max()))
    offset = trials.offsets(number, obstacles.points[sphere])
    along = ChainInterpolator(chain).distance(obstacles.s_m[sphere], trials.s_m[number])
    # A distant part of the gripped chain that passes near the grasp counts as another strand.
    is_local = along <= 2 * np.linalg.norm(offset, axis=1) + trials.gripper.finger_width_m
    gripped = (obstacles.chain[sphere] == chain.id) & is_local
    distance = trials.distances(number, offset, closing=~gripped) - obstacles.radius_m[sphere]
    clearance = np.full(len(trials.T), MAX_RELEVANT_DISTANCE_M)
    np.minimum.at(clearance, number[~gripped], distance[~gripped])
    touches = np.zeros(len(trials.T), dtype=bool)
    touches[number[gripped & (distance < min_string_distance_m - ROUNDING_M)]] = True
    return clearance, touches


def _clearance_from_objects(trials: _Trials, objects: ObjectPoints) -> NDArray[np.float64]:
    """Return the clearances (N,) from objects, metres, at most `MAX_RELEVANT_DISTANCE_M`.

    A clearance below `Gripper.clearance_m` is only an upper bound, because the grasp is rejected anyway. The spheres of
    a cell are checked one by one only if the cell may contain the nearest sphere.
    """
    clearance = np.full(len(trials.T), MAX_RELEVANT_DISTANCE_M)
    if len(objects.points) == 0:
        return clearance
    max_extent = float(objects.extent_m.max()) + objects.radius_m
    number, cell = _near_pairs(trials, objects.centre, objects.tree_xy, max_extent)
    to_centre = trials.distances(number, trials.offsets(number, objects.centre[cell])) - objects.radius_m
    np.minimum.at(clearance, number, to_centre + objects.extent_m[cell])
    is_unresolved = to_centre - objects.extent_m[cell] < clearance[number]
    is_unresolved &= clearance[number] >= trials.gripper.clearance_m
    cell = cell[is_unresolved]
    sphere = objects.spheres_of(cell)
    number = np.repeat(number[is_unresolved], objects.count[cell])
    distance = trials.distances(number, trials.offsets(number, objects.points[sphere])) - objects.radius_m
    np.minimum.at(clearance, number, distance)
    return clearance


def _clearance_from_edges(trials: _Trials, edges: NDArray[np.float64], cell_radius_m: float) -> NDArray[np.float64]:
    """Return the clearances (N,) from the edges of objects that are higher than the fingertips, metres.

    The clearances are at most `MAX_RELEVANT_DISTANCE_M`. `edges` (K, 3) are the edge cells of objects on the table, and
    `cell_radius_m` is half the edge length of a cell.
    """
    clearance = np.full(len(trials.T), MAX_RELEVANT_DISTANCE_M)
    tip_z = trials.T[:, 2, 3] + trials.T[:, 2, 2] * trials.reach_m
    edges = edges[edges[:, 2] > tip_z.min(initial=np.inf)]
    if len(edges) == 0:
        return clearance
    number, edge = _near_pairs(trials, edges, KDTree(edges[:, :2]), cell_radius_m)
    is_higher = edges[edge, 2] > tip_z[number]
    number = number[is_higher]
    distance = trials.distances(number, trials.offsets(number, edges[edge[is_higher]])) - cell_radius_m
    np.minimum.at(clearance, number, distance)
    return clearance


def _near_pairs(
    trials: _Trials, points: NDArray[np.float64], tree_xy: KDTree, extent_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return pairs of a grasp and an obstacle that may be closer than `MAX_RELEVANT_DISTANCE_M`.

    Args:
        trials: Grasps to check.
        points: (P, 3) obstacle points, metres, base frame.
        tree_xy: Search tree of the obstacle points in the table plane.
        extent_m: Maximum distance from an obstacle point to the surface of its obstacle, metres.

    Returns:
        Grasp indices (K,) and obstacle indices (K,).
    """
    T = trials.T
    gripper = trials.gripper
    radius = MAX_RELEVANT_DISTANCE_M + extent_m
    radius += np.hypot(gripper.half_span_m, gripper.palm_width_m / 2)
    # A tilted gripper may touch a high object beside the grasp.
    height_range = float(np.ptp(np.append(points[:, 2], T[:, 2, 3])))
    radius += height_range * float(np.abs(T[:, 2, 0] / T[:, 2, 2]).max())
    near = KDTree(T[:, :2, 3]).sparse_distance_matrix(tree_xy, radius, output_type="ndarray")
    number = near["i"]
    obstacle = near["j"]
    is_tilted = T[:, 2, 2].max() > -1.0
    if is_tilted:
        return number, obstacle
    # An upright palm is far above most obstacles, and only the fingers are near them.
    beside = MAX_RELEVANT_DISTANCE_M + extent_m
    half_opening = trials.opening_m / 2 + gripper.finger_thickness_m
    finger_radius = np.hypot(half_opening, gripper.finger_width_m / 2) + beside
    near_palm_z = T[:, 2, 3] + gripper.finger_depth_m - trials.reach_m - beside
    counts = (near["v"] <= finger_radius[number]) | (points[obstacle, 2] >= near_palm_z[number])
    return number[counts], obstacle[counts]


def _grasp_frames(point: NDArray[np.float64], direction: NDArray[np.float64], tilt: float) -> NDArray[np.float64]:
    """Return the poses T_base_grasp (N, 4, 4): y along `direction` (N, 3), z down, tilted by `tilt` (rad) about y."""
    down = np.broadcast_to((0.0, 0.0, -1.0), direction.shape)
    left = np.cross(direction, down)
    T = np.zeros((len(point), 4, 4))
    T[:, :3, 0] = np.cos(tilt) * left - np.sin(tilt) * down
    T[:, :3, 1] = direction
    T[:, :3, 2] = np.cos(tilt) * down + np.sin(tilt) * left
    T[:, :3, 3] = point
    T[:, 3, 3] = 1.0
    return T
