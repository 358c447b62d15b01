"""Reach of grasps: whether the arm can carry them out, with which joint angles, and why not.

Flange poses of grasps and a model of the cell go in. Joint angles of pre-grasp and grasp come out, in one branch of the
inverse kinematics, with a straight descent between them that is free of collisions.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cell.config.arm_models import ArmModelName
from cell.config.cell_config import CellSettings
from cell.kinematics.collision import PARTS, CollisionModel, grasp_collision_model
from cell.kinematics.ik_branches import MIN_SINGULAR_VALUE, OUT_OF_REACH, SINGULAR, TOO_NEAR, USED_LIMIT_RAD
from cell.kinematics.joint_paths import PathFinder
from cell.kinematics.ur_kinematics import ARMS, frames_jacobian, inverse_each, jacobian, link_frames, pose_error
from recognition.grasping.flange_poses import FlangePoses
from recognition.grasping.gripper import Gripper

STEP_M = 0.005
"""Largest distance between two samples of the descent."""
NEWTON_STEPS = 2
"""Newton steps at each sample of the descent. They begin where the joints go on, 0.1 mm off, and square the error."""
TOLERANCE = 1e-7
"""Largest error of a sample of the descent, metres and radians."""
MAX_STEP_RAD = 0.15
"""Largest motion of a joint between two samples. A larger one is a change of the branch or nearly a singularity."""
POINT_CLEARANCE_M = 0.005
"""Smallest distance of arm and camera from points that were measured on the table."""
CHECKED_PATHS = 3
"""Number of postures of a grasp with a free descent, nearest first, among which one with a free path there is taken."""

APPROACH_M = 0.003
"""Further approach that is allowed on the path from a reference that is nearer to something than the clearance."""
TRAVEL_M = 0.02
"""Smallest height of the gripper above the table on the path to the pre-grasp, where it opens to its largest."""
_AGAINST_POINTS = [PARTS.index("elbow") + k for k in range(len(PARTS) - PARTS.index("elbow"))]
"""Parts that keep clear of measured points: all from the elbow on, without the gripper."""

JOINT_LIMIT = "a joint would be beyond its limit"
NO_STRAIGHT_DESCENT = "the arm cannot go straight down from the pre-grasp without a change of its posture"
SINGULAR_DESCENT = "on the descent, the arm would be stretched, or its wrist straight, near a singular posture"

ReachReason = Literal[
    "out-of-reach",
    "joint-limit",
    "singular",
    "no-straight-descent",
    "collision-arm",
    "collision-camera",
    "collision-gripper",
]
"""Why a grasp cannot be reached. Of several reasons, it is the one of the posture that gets farthest."""


@dataclass(frozen=True, eq=False)
class ReachModel:
    """What decides in a cell whether a grasp can be reached."""

    collisions: CollisionModel
    """Arm, camera and gripper, the table and the obstacles."""
    reference_q_rad: NDArray[np.float64]
    """Joint angles (6,) from which the arm moves to the pre-grasp: home, or the present ones."""
    travel_clearances: NDArray[np.float64]
    """Smallest distances (C,) on the path to the pre-grasp, where the gripper keeps clear of the table, too."""
    table_points: NDArray[np.float64] | None = None
    """Measured points (P, 3) of what lies on the table, base frame, from which arm and camera keep clear. The gripper
    is not compared with them, since the planner of the grasps does that. None means an empty table."""


@dataclass(frozen=True, eq=False)
class GraspReach:
    """Whether the arm can carry out a grasp."""

    reachable: bool
    """Whether a posture with a free, straight descent exists."""
    q_pregrasp_rad: NDArray[np.float64] | None
    """Joint angles (6,) at the pre-grasp, or None if it is not reachable."""
    q_grasp_rad: NDArray[np.float64] | None
    """Joint angles (6,) at the grasp, in the same branch, or None. Go there by a straight line of the flange (moveL): a
    straight line in joint space is up to 3 mm beside it."""
    turned: bool
    """Whether the gripper is turned by pi about the approach direction, as `FlangePoses.turned` has it."""
    path_free: bool | None
    """Whether the straight line in joint space from the reference to the pre-grasp is free of collisions. None if it is
    not reachable or not checked."""
    min_singular_value: float
    """Smallest singular value of the Jacobian on the descent, metres and radians mixed. 0 if it is not reachable."""
    reason: ReachReason | None
    """Why it is not reachable, or None."""
    message: str | None
    """The reason for people, or None."""


def reach_model(
    settings: CellSettings,
    T_flange_camera: NDArray[np.float64],
    gripper: Gripper,
    reference_q_rad: NDArray[np.float64],
    table_points: NDArray[np.float64] | None = None,
) -> ReachModel:
    """Return the reach model of a cell.

    Args:
        settings: Settings of the cell: arm, table, obstacles, clearance and camera body.
        T_flange_camera: Camera pose on the flange (4, 4).
        gripper: Gripper on the flange.
        reference_q_rad: Joint angles (6,) from which the arm moves to a pre-grasp.
        table_points: Points (P, 3) of what lies on the table, as in `ReachModel`.
    """
    collisions = grasp_collision_model(settings, T_flange_camera, gripper)
    reference = np.array(reference_q_rad, dtype=np.float64)
    of_gripper = (collisions.contact_parts >= len(PARTS)) & np.char.endswith(collisions.contacts, "the table")
    travel = np.where(of_gripper, min(TRAVEL_M, settings.mounting.clearance_m), collisions.clearances)
    # the arm may stand nearer to something than that, and may leave it
    travel = np.minimum(travel, collisions.gaps(reference[None])[0] - APPROACH_M)
    points = None if table_points is None or not len(table_points) else table_points
    return ReachModel(collisions, reference, travel, points)


def find_reach(
    model: ReachModel, poses: FlangePoses, opening_m: NDArray[np.float64], *, check_paths: bool = True
) -> tuple[GraspReach, ...]:
    """Return for each grasp whether the arm can carry it out, and with which joint angles.

    Both turns of each grasp are tried: turned by pi, the last joint differs by pi, and the camera is elsewhere. The
    posture nearest to the reference is taken, by its leading joint. Among the first `CHECKED_PATHS` of them, one to
    which a straight line in joint space is free comes first.

    A posture must meet all of these conditions, at each sample of the descent:

    - no joint is beyond `USED_LIMIT_RAD`;
    - the smallest singular value of the Jacobian is at least `MIN_SINGULAR_VALUE`;
    - arm and camera keep the clearance of the cell from table, obstacles and one another;
    - the gripper keeps it from arm and obstacles. Its fingertips may come down to the table.

    Args:
        model: Model of the cell.
        poses: Flange poses of N grasps. Pre-grasp and grasp have the same orientation.
        opening_m: Openings (N,) between the fingers on the descent, metres.
        check_paths: Whether the paths from the reference are checked. Without, `path_free` is None.

    Returns:
        The reach of each grasp, in their order.
    """
    search = _Search(model, poses, np.asarray(opening_m, dtype=np.float64))
    count = 1
    while len((postures := search.next_postures(count)).grasp):
        free = search.check_descents(postures)
        if check_paths:
            search.check_paths(free)
        count *= 2  # most grasps need one posture; many are checked together for the others
    return tuple(search.result(grasp) for grasp in range(len(poses.grasp)))


@dataclass(frozen=True, eq=False)
class _Postures:
    """Postures at the pre-grasps, the nearest to the reference first."""

    q_rad: NDArray[np.float64]
    """Joint angles (M, 6)."""
    grasp: NDArray[np.int64]
    """Grasp (M,) of each."""
    turned: NDArray[np.bool_]
    """Whether the gripper of each (M,) is turned by pi."""


@dataclass(frozen=True)
class _Failure:
    """Why a posture is not possible."""

    stage: int
    """Progress of the check, which is larger for a posture that gets farther."""
    short: float
    """Lack of clearance, metres, or 0."""
    reason: ReachReason
    message: str


class _Search:
    """Search for a posture of each grasp."""

    def __init__(self, model: ReachModel, poses: FlangePoses, opening_m: NDArray[np.float64]) -> None:
        self._model, self._poses, self._opening = model, poses, opening_m
        self._collisions = model.collisions
        self._arm: ArmModelName = model.collisions.model
        self._failures = [_no_solution(self._collisions, T) for T in poses.pregrasp]
        self._free: list[list[GraspReach]] = [[] for _ in poses.pregrasp]
        self._paths = PathFinder(self._collisions, model.reference_q_rad)
        self._left = self._solutions()

    def next_postures(self, count: int) -> _Postures:
        """Return the next `count` postures of each grasp that still needs one, and remove them from those left."""
        left = self._left
        wanted = ~np.array([self._is_decided(found) for found in self._free], dtype=np.bool_)
        before = np.zeros(len(self._free), dtype=np.int64)
        taken = np.zeros(len(left.grasp), dtype=np.bool_)
        for index, grasp in enumerate(left.grasp.tolist()):
            taken[index] = wanted[grasp] and before[grasp] < count
            before[grasp] += 1
        self._left = _select(left, ~taken)
        return _select(left, taken)

    def check_descents(self, postures: _Postures) -> list[tuple[int, int]]:
        """Check the descents, and return the grasp and the number of each free one."""
        path, values, straight = self._descend(postures)
        for k in np.flatnonzero(~straight):
            self._fail(postures.grasp[k], _Failure(2, 0.0, "no-straight-descent", NO_STRAIGHT_DESCENT))
        beyond = np.abs(path).max(axis=(1, 2)) > USED_LIMIT_RAD
        for k in np.flatnonzero(straight & beyond):
            self._fail(postures.grasp[k], _Failure(2, 0.0, "joint-limit", JOINT_LIMIT))
        singular = values < MIN_SINGULAR_VALUE
        for k in np.flatnonzero(straight & ~beyond & singular):
            self._fail(postures.grasp[k], _Failure(2, 0.0, "singular", SINGULAR_DESCENT))
        possible = straight & ~beyond & ~singular
        # most collisions are at the grasp itself
        for samples in (slice(-1, None), slice(None, -1)):
            chosen = np.flatnonzero(possible)
            possible[chosen] = self._are_free(path[chosen, samples], postures.grasp[chosen])
        free = []
        for k in np.flatnonzero(possible):
            grasp = int(postures.grasp[k])
            q_pregrasp, q_grasp = path[k, 0], path[k, -1]
            reach = GraspReach(True, q_pregrasp, q_grasp, bool(postures.turned[k]), None, float(values[k]), None, None)
            free.append((grasp, len(self._free[grasp])))
            self._free[grasp].append(reach)
        return free

    def check_paths(self, free: list[tuple[int, int]]) -> None:
        """Check the paths from the reference to some of the postures with a free descent."""
        checked = [(grasp, number) for grasp, number in free if number < CHECKED_PATHS]
        if not checked:
            return
        q = np.array([self._free[grasp][number].q_pregrasp_rad for grasp, number in checked])
        are_free = self._paths.are_free(self._model.reference_q_rad, q, self._model.travel_clearances)
        for (grasp, number), is_free in zip(checked, are_free.tolist(), strict=True):
            self._free[grasp][number] = replace(self._free[grasp][number], path_free=is_free)

    def result(self, grasp: int) -> GraspReach:
        """Return the reach of a grasp."""
        found, failure = self._free[grasp], self._failures[grasp]
        if found:
            return next((reach for reach in found if reach.path_free), found[0])
        return GraspReach(False, None, None, False, None, 0.0, failure.reason, failure.message)

    def _is_decided(self, found: list[GraspReach]) -> bool:
        """Return whether no further posture is needed: one has a free path, or paths are not checked, or enough are."""
        return bool(found) and (found[-1].path_free is not False or len(found) >= CHECKED_PATHS)

    def _fail(self, grasp: int, failure: _Failure) -> None:
        known = self._failures[grasp]
        if (failure.stage, -failure.short) > (known.stage, -known.short):
            self._failures[grasp] = failure

    def _solutions(self) -> _Postures:
        """Return the postures at the pre-grasps that are far from singularities, in both turns."""
        q, grasp = inverse_each(self._arm, self._poses.pregrasp)
        agile = np.linalg.svd(jacobian(self._arm, q), compute_uv=False)[:, -1] >= MIN_SINGULAR_VALUE
        for k in np.flatnonzero(~agile):
            self._fail(grasp[k], _Failure(1, 0.0, "singular", SINGULAR))
        q, grasp = np.repeat(q[agile], 2, axis=0), np.repeat(grasp[agile], 2)
        turned = np.arange(len(q)) % 2 == 1
        q[turned, 5] += np.pi
        # each joint in the turn nearest to the reference, within its limits
        choices = q[:, :, None] + 2 * np.pi * np.arange(-1, 2)
        off = np.abs(choices - self._model.reference_q_rad[:, None])
        nearest = np.where(np.abs(choices) <= USED_LIMIT_RAD, off, np.inf).argmin(axis=2)
        q = np.take_along_axis(choices, nearest[:, :, None], axis=2)[:, :, 0]
        order = np.abs(q - self._model.reference_q_rad).max(axis=1).argsort(kind="stable")
        return _Postures(q[order], grasp[order], turned[order])

    def _are_free(self, q: NDArray[np.float64], grasp: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether each path (K,) keeps all clearances at its samples `q` (K, S, 6)."""
        if not q.size:
            return np.ones(len(q), dtype=np.bool_)
        each = q.reshape(-1, 6)
        short = self._collisions.clearances - self._collisions.gaps(each, np.repeat(self._opening[grasp], q.shape[1]))
        if self._model.table_points is not None:
            near = POINT_CLEARANCE_M - self._collisions.point_gaps(each, self._model.table_points)
            short = np.concatenate([short, near[:, _AGAINST_POINTS]], axis=1)
        worst = short.reshape(len(q), q.shape[1], -1).max(axis=1)
        contact = worst.argmax(axis=1)
        worst = worst.max(axis=1)
        for k in np.flatnonzero(worst > 0):
            self._fail(grasp[k], self._contact_failure(int(contact[k]), float(worst[k])))
        return worst <= 0

    def _contact_failure(self, contact: int, short: float) -> _Failure:
        known = len(self._collisions.contacts)
        if contact < known:
            part, message = int(self._collisions.contact_parts[contact]), self._collisions.contacts[contact]
        else:
            part = _AGAINST_POINTS[contact - known]
            message = f"the {PARTS[part]} comes too near what lies on the table"
        if part >= len(PARTS):
            return _Failure(3, short, "collision-gripper", message)
        return _Failure(3, short, "collision-camera" if "camera" in PARTS[part] else "collision-arm", message)

    def _descend(self, postures: _Postures) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return the joint angles on straight descents.

        Returns:
            Joint angles (K, S, 6) at the samples, the smallest singular value (K,) on each descent, and whether each
            descent (K,) stays in its branch down to the grasp.
        """
        start = self._poses.pregrasp[postures.grasp]
        if len(start) and postures.turned.any():
            start = start.copy()
            start[postures.turned, :3, :2] *= -1
        offset = self._poses.grasp[postures.grasp, :3, 3] - start[:, :3, 3]
        steps = max(int(np.ceil(np.linalg.norm(offset, axis=1).max(initial=0.0) / STEP_M - 1e-9)), 2)
        targets = np.repeat(start[:, None], steps + 1, axis=1)
        targets[:, :, :3, 3] += np.linspace(0.0, 1.0, steps + 1)[:, None] * offset[:, None]
        path = np.repeat(postures.q_rad[:, None], steps + 1, axis=1)
        for step in range(1, steps + 1):
            q = 2 * path[:, step - 1] - path[:, max(step - 2, 0)]
            for _ in range(NEWTON_STEPS + (step == 1)):
                q = q + _newton_step(self._arm, q, targets[:, step])
            path[:, step] = q
        reached = link_frames(self._arm, path.reshape(-1, 6))[:, 6]
        error = np.abs(pose_error(targets.reshape(-1, 4, 4), reached)).reshape(len(path), -1).max(axis=1)
        straight = (error < TOLERANCE) & (np.abs(np.diff(path, axis=1)).max(axis=(1, 2)) < MAX_STEP_RAD)
        # the measure changes slowly along a descent, so three samples show the smallest value
        shown = path[:, [0, steps // 2, steps]]
        return path, np.linalg.svd(jacobian(self._arm, shown), compute_uv=False)[..., -1].min(axis=1), straight


def _no_solution(collisions: CollisionModel, T_base_flange: NDArray[np.float64]) -> _Failure:
    """Return why the inverse kinematics may have no solution for a flange pose (4, 4)."""
    arm = ARMS[collisions.model]
    wrist = T_base_flange[:2, 3] - arm.d_m[5] * T_base_flange[:2, 2]
    return _Failure(0, 0.0, "out-of-reach", TOO_NEAR if np.linalg.norm(wrist) < arm.d_m[3] else OUT_OF_REACH)


def _newton_step(arm: ArmModelName, q: NDArray[np.float64], T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Newton step (N, 6) from joint angles (N, 6) to flange poses (N, 4, 4), slightly damped."""
    frames = link_frames(arm, q)
    J, error = frames_jacobian(frames), pose_error(T_base_flange, frames[:, 6])
    Jt = J.swapaxes(1, 2)
    return np.asarray(np.linalg.solve(Jt @ J + 1e-12 * np.eye(6), Jt @ error[..., None])[..., 0], dtype=np.float64)


def _select(postures: _Postures, mask: NDArray[np.bool_]) -> _Postures:
    return _Postures(postures.q_rad[mask], postures.grasp[mask], postures.turned[mask])
