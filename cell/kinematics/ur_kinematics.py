"""Forward and inverse kinematics of the UR e-Series arms.

The frames are those of the controller: base with z up along the first joint's axis, flange with z outwards.
`T_base_flange` maps flange points to base. The dimensions are nominal. The calibrated pose of a real controller differs
from them by up to a few millimetres, so the pose of a view is read from the controller.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from ik_geo.ik_geo import Robot
from numpy.typing import ArrayLike, NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.config.arm_models import ArmModelName

JOINT_LIMIT_RAD = 2.0 * np.pi
"""Largest angle of every joint in both directions ..."""
ENDLESS_WRIST: frozenset[ArmModelName] = frozenset({"ur3e"})
"""... except the last joint of these arms, which has no limit."""

SAME_SOLUTION_RAD = 1e-5
"""Largest difference of two vectors of joint angles that are one solution."""
POSE_TOLERANCE = 1e-7
"""Largest difference between the pose of a solution and the requested pose, metres and radians."""


@dataclass(frozen=True)
class ArmModel:
    """Denavit-Hartenberg parameters and joint speeds of an arm, from the maker's data sheets."""

    d_m: tuple[float, float, float, float, float, float]
    """Offset along the axis of each joint."""
    a_m: tuple[float, float, float, float, float, float]
    """Length of each link along x of the frame after the joint."""
    speed_rad_s: tuple[float, float, float, float, float, float]
    """Largest speed of each joint."""


ALPHA_RAD = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
"""Twist of each link, the same in all UR arms."""

_FAST, _MEDIUM, _SLOW = np.deg2rad((360.0, 180.0, 120.0)).tolist()

ARMS: dict[ArmModelName, ArmModel] = {
    "ur3e": ArmModel(
        d_m=(0.15185, 0.0, 0.0, 0.13105, 0.08535, 0.0921),
        a_m=(0.0, -0.24355, -0.2132, 0.0, 0.0, 0.0),
        speed_rad_s=(_MEDIUM, _MEDIUM, _MEDIUM, _FAST, _FAST, _FAST),
    ),
    "ur5e": ArmModel(
        d_m=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996),
        a_m=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0),
        speed_rad_s=(_MEDIUM, _MEDIUM, _MEDIUM, _MEDIUM, _MEDIUM, _MEDIUM),
    ),
    "ur10e": ArmModel(
        d_m=(0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655),
        a_m=(0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0),
        speed_rad_s=(_SLOW, _SLOW, _MEDIUM, _MEDIUM, _MEDIUM, _MEDIUM),
    ),
}


@cache
def _nudges() -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return small displacements with their inverses.

    At degenerate poses, such as usual home poses, the solver drops solutions. Poses beside them have all solutions, and
    Newton steps lead back. A stretched arm needs larger offsets. They are made at the first use, because that imports
    SciPy: a process that needs only the forward kinematics starts in half the time.
    """
    return [
        (from_rotation_vector(size * shift, size * turn), from_rotation_vector(-size * shift, -size * turn))
        for size, shift, turn in (
            (1e-7, np.array([0.3, -0.7, 0.4]), np.array([1.0, 2.0, -1.5])),
            (1e-6, np.array([-0.2, 0.3, -1.0]), np.array([-2.0, 1.0, 1.0])),
            (1e-6, np.array([1.0, 0.2, 0.1]), np.array([0.5, -0.3, 2.0])),
            (1e-6, np.array([0.1, 1.0, 0.2]), np.array([0.5, 0.2, -0.1])),
        )
    ]


def joint_limits(model: ArmModelName) -> NDArray[np.float64]:
    """Return the largest angle (6,) of each joint in both directions, rad. It is infinite for an endless wrist."""
    limits = np.full(6, JOINT_LIMIT_RAD)
    if model in ENDLESS_WRIST:
        limits[5] = np.inf
    return limits


def joint_speeds(model: ArmModelName) -> NDArray[np.float64]:
    """Return the largest speed (6,) of each joint, rad/s."""
    return np.array(ARMS[model].speed_rad_s)


def forward(model: ArmModelName, q_rad: ArrayLike) -> NDArray[np.float64]:
    """Return `T_base_flange` (4, 4) at the joint angles (6,)."""
    return link_frames(model, q_rad)[6]


def link_frames(model: ArmModelName, q_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the frames (..., 7, 4, 4) of base and links at joint angles (..., 6).

    Frame k maps points of link k to base. Frame 0 is the base and frame 6 the flange. Joint k + 1 turns about z of
    frame k.
    """
    q = np.asarray(q_rad, dtype=np.float64)
    arm = ARMS[model]
    c, s = np.cos(q), np.sin(q)
    frames = np.zeros((*q.shape[:-1], 7, 4, 4))
    frames[..., 0, :, :] = np.eye(4)
    for k, (d, a, alpha) in enumerate(zip(arm.d_m, arm.a_m, ALPHA_RAD, strict=True)):
        # exact zeros instead of cos(pi / 2)
        ca, sa = np.round(np.cos(alpha)), np.round(np.sin(alpha))
        step = np.zeros((*q.shape[:-1], 4, 4))
        step[..., 0, 0], step[..., 0, 1], step[..., 0, 2] = c[..., k], -s[..., k] * ca, s[..., k] * sa
        step[..., 1, 0], step[..., 1, 1], step[..., 1, 2] = s[..., k], c[..., k] * ca, -c[..., k] * sa
        step[..., 0, 3], step[..., 1, 3] = a * c[..., k], a * s[..., k]
        step[..., 2, 1], step[..., 2, 2], step[..., 2, 3], step[..., 3, 3] = sa, ca, d, 1.0
        frames[..., k + 1, :, :] = frames[..., k, :, :] @ step
    return frames


def jacobian(model: ArmModelName, q_rad: ArrayLike) -> NDArray[np.float64]:
    """Return the geometric Jacobian (..., 6, 6) of the flange's origin at joint angles (..., 6), base frame.

    Rows 0 to 2 are the velocity, metres per radian. Rows 3 to 5 are the angular velocity.
    """
    return frames_jacobian(link_frames(model, q_rad))


def frames_jacobian(frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Jacobian (..., 6, 6), as `jacobian` does, for link frames (..., 7, 4, 4)."""
    axes, origins = frames[..., :6, :3, 2], frames[..., :6, :3, 3]
    arms = frames[..., 6:, :3, 3] - origins
    return np.concatenate([np.cross(axes, arms), axes], axis=-1).swapaxes(-1, -2)


def flange_speeds(
    model: ArmModelName, q_rad: NDArray[np.float64], qd_rad_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the speeds (N,) of the flange's origin, m/s, as the Jacobian gives them, in less time.

    The first joint turns the whole arm and the last one turns the flange about its origin, so neither angle matters.

    Args:
        model: Model of the arm.
        q_rad: Joint angles (N, 6).
        qd_rad_s: Joint speeds (N, 6).
    """
    arm = ARMS[model]
    _, upper, fore, _, _, _ = arm.a_m
    _, _, _, aside, wrist, flange = arm.d_m
    # joints 2 to 4 turn about parallel axes, so their angles add up
    shoulder, elbow, bend, turn = q_rad[:, 1], q_rad[:, 1] + q_rad[:, 2], q_rad[:, 1:4].sum(axis=1), q_rad[:, 4]
    base_speed, shoulder_speed, turn_speed = qd_rad_s[:, 0], qd_rad_s[:, 1], qd_rad_s[:, 4]
    elbow_speed = shoulder_speed + qd_rad_s[:, 2]
    bend_speed = elbow_speed + qd_rad_s[:, 3]
    c_bend, s_bend, c_turn, s_turn = np.cos(bend), np.sin(bend), np.cos(turn), np.sin(turn)
    # outwards and upwards in the plane of upper arm and forearm, and across it
    out = upper * np.cos(shoulder) + fore * np.cos(elbow) + wrist * s_bend - flange * s_turn * c_bend
    across = aside + flange * c_turn
    tangential, radial = wrist * bend_speed - flange * c_turn * turn_speed, flange * s_turn * bend_speed
    out_speed = (
        -upper * shoulder_speed * np.sin(shoulder)
        - fore * elbow_speed * np.sin(elbow)
        + tangential * c_bend
        + radial * s_bend
    )
    up_speed = (
        upper * shoulder_speed * np.cos(shoulder)
        + fore * elbow_speed * np.cos(elbow)
        + tangential * s_bend
        - radial * c_bend
    )
    across_speed = -flange * s_turn * turn_speed
    return np.sqrt((out_speed + base_speed * across) ** 2 + up_speed**2 + (base_speed * out - across_speed) ** 2)


def inverse(model: ArmModelName, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return all joint angles (N, 6) that reach the flange pose, each in (-pi, pi]. N is 0 to 8.

    Infinitely many solutions reach a singular pose. Some of them are returned, which may be more than 8, or none if the
    arm is also stretched. Collisions and joint limits are not checked. A full turn of any joint gives the same pose.

    Args:
        model: Model of the arm.
        T_base_flange: Flange pose (4, 4).
    """
    return inverse_each(model, np.asarray(T_base_flange)[None])[0]


def inverse_each(
    model: ArmModelName, T_base_flange: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the solutions of `inverse` for poses (N, 4, 4): joint angles (M, 6), and the pose of each (M,)."""
    T = np.asarray(T_base_flange, dtype=np.float64)
    found = [_solutions(model, pose) for pose in T]
    which = np.repeat(np.arange(len(T)), [len(q) for q in found])
    q = np.concatenate([np.zeros((0, 6)), *found])
    error = pose_error(T[which], link_frames(model, q)[:, 6])
    for _ in range(12):
        rough = np.flatnonzero(np.abs(error).max(axis=1) > 1e-11)
        if not len(rough):
            break
        q[rough] += (np.linalg.pinv(jacobian(model, q[rough]), rcond=1e-5) @ error[rough, :, None])[..., 0]
        error[rough] = pose_error(T[which[rough]], link_frames(model, q[rough])[:, 6])
    good = np.abs(error).max(axis=1) < POSE_TOLERANCE
    q, which = _wrapped(q[good]), which[good]
    new = _new(q, which)
    return q[new], which[new]


def _solutions(model: ArmModelName, T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return joint angles (N, 6) that reach a pose beside `T`."""
    solver, R_straight = _solver(model)
    for nudges in _nudges():
        beside = [T @ nudge for nudge in nudges]
        # the solver reads nested lists column by column
        asked = [((pose[:3, :3] @ R_straight.T).T.tolist(), pose[:3, 3].tolist()) for pose in beside]
        found = [q for R, t in asked for q, is_nearest_only in solver.get_ik(R, t) if not is_nearest_only]
        q = np.array(found, dtype=np.float64).reshape(-1, 6)
        q = q[np.isfinite(q).all(axis=1)]
        if len(q):
            return q
    return np.zeros((0, 6))


@cache
def _solver(model: ArmModelName) -> tuple[Robot, NDArray[np.float64]]:
    """Return the solver of the arm, and the flange's orientation (3, 3) at zero joint angles, to which it refers.

    Joints 2 to 4 are parallel, and the axes of joints 5 and 6 intersect.
    """
    straight = link_frames(model, np.zeros(6))
    origins = straight[:, :3, 3]
    links = np.diff(origins, axis=0, prepend=origins[:1] * 0.0)
    robot = Robot.three_parallel_two_intersecting(straight[:6, :3, 2].tolist(), links.tolist())
    return robot, straight[6, :3, :3]


def pose_error(T: NDArray[np.float64], reached: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the errors (N, 6) of reached poses (N, 4, 4), as translation and small rotation vector, base frame."""
    turn = T[:, :3, :3] @ reached[:, :3, :3].swapaxes(1, 2)
    skew = 0.5 * (turn - turn.swapaxes(1, 2))
    turns = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return np.concatenate([T[:, :3, 3] - reached[:, :3, 3], turns], axis=1)


def _new(q: NDArray[np.float64], which: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return for each solution (N, 6) whether none of the few before it is the same."""
    new = np.ones(len(q), dtype=np.bool_)
    for back in range(1, 16):
        same = np.abs(_wrapped(q[back:] - q[:-back])).max(axis=1, initial=0.0) < SAME_SOLUTION_RAD
        new[back:] &= ~(same & (which[back:] == which[:-back]))
    return new


def _wrapped(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wrap angles to (-pi, pi]."""
    return np.pi - np.mod(np.pi - q, 2 * np.pi)
