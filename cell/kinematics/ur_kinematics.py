"""Forward and inverse kinematics of the UR e-Series arms.

Frames are the controller's own: base with z up along the first joint's axis, flange with z out of it. `T_base_flange`
maps flange points to base. The tables are the nominal ones: a real controller's calibrated pose differs from them by
up to a few millimetres, so poses that matter are read from the controller and not computed here.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from ik_geo.ik_geo import Robot
from numpy.typing import ArrayLike, NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.config.arm_config import ArmModelName

JOINT_LIMIT_RAD = 2.0 * np.pi
"""Every joint turns so far either way ..."""
ENDLESS_WRIST: frozenset[ArmModelName] = frozenset({"ur3e"})
"""... but the last one of these arms, which turns without end."""

SAME_SOLUTION_RAD = 1e-5
"""Joint vectors nearer than this are one solution."""
POSE_TOLERANCE = 1e-7
"""Greatest deviation, metres and radians, of a solution's pose from the asked one."""


@dataclass(frozen=True)
class ArmModel:
    """An arm's Denavit-Hartenberg table and speeds, from the maker's data sheets."""

    d_m: tuple[float, float, float, float, float, float]
    """Offset along each joint's axis."""
    a_m: tuple[float, float, float, float, float, float]
    """Length of each link: along x of the frame behind the joint."""
    speed_rad_s: tuple[float, float, float, float, float, float]
    """Fastest turn of each joint."""


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

# At degenerate poses, among them usual home poses, the solver drops solutions. Poses on either side have them all, and
# Newton steps lead back; a stretched arm needs wider nudges.
_NUDGES = [
    (from_rotation_vector(size * shift, size * turn), from_rotation_vector(-size * shift, -size * turn))
    for size, shift, turn in (
        (1e-7, np.array([0.3, -0.7, 0.4]), np.array([1.0, 2.0, -1.5])),
        (1e-6, np.array([-0.2, 0.3, -1.0]), np.array([-2.0, 1.0, 1.0])),
        (1e-6, np.array([1.0, 0.2, 0.1]), np.array([0.5, -0.3, 2.0])),
        (1e-6, np.array([0.1, 1.0, 0.2]), np.array([0.5, 0.2, -0.1])),
    )
]


def joint_limits(model: ArmModelName) -> NDArray[np.float64]:
    """The greatest angle (6,) of each joint either way, radians; infinite for an endless wrist."""
    limits = np.full(6, JOINT_LIMIT_RAD)
    if model in ENDLESS_WRIST:
        limits[5] = np.inf
    return limits


def joint_speeds(model: ArmModelName) -> NDArray[np.float64]:
    """The fastest turn (6,) of each joint, rad/s."""
    return np.array(ARMS[model].speed_rad_s)


def forward(model: ArmModelName, q_rad: ArrayLike) -> NDArray[np.float64]:
    """`T_base_flange` (4, 4) at the joint angles (6,)."""
    return link_frames(model, q_rad)[6]


def link_frames(model: ArmModelName, q_rad: ArrayLike) -> NDArray[np.float64]:
    """The frames (..., 7, 4, 4) of base and links at joint angles (..., 6): `[..., k]` maps link k's points to base.

    Frame 0 is the base, frame 6 the flange; joint k + 1 turns about z of frame k.
    """
    q = np.asarray(q_rad, dtype=np.float64)
    arm = ARMS[model]
    c, s = np.cos(q), np.sin(q)
    frames = np.zeros((*q.shape[:-1], 7, 4, 4))
    frames[..., 0, :, :] = np.eye(4)
    for k, (d, a, alpha) in enumerate(zip(arm.d_m, arm.a_m, ALPHA_RAD, strict=True)):
        # Exact zeros instead of cos(pi / 2) keep the sparse entries clean.
        ca, sa = np.round(np.cos(alpha)), np.round(np.sin(alpha))
        step = np.zeros((*q.shape[:-1], 4, 4))
        step[..., 0, 0], step[..., 0, 1], step[..., 0, 2] = c[..., k], -s[..., k] * ca, s[..., k] * sa
        step[..., 1, 0], step[..., 1, 1], step[..., 1, 2] = s[..., k], c[..., k] * ca, -c[..., k] * sa
        step[..., 0, 3], step[..., 1, 3] = a * c[..., k], a * s[..., k]
        step[..., 2, 1], step[..., 2, 2], step[..., 2, 3], step[..., 3, 3] = sa, ca, d, 1.0
        frames[..., k + 1, :, :] = frames[..., k, :, :] @ step
    return frames


def jacobian(model: ArmModelName, q_rad: ArrayLike) -> NDArray[np.float64]:
    """The geometric Jacobian (..., 6, 6) of the flange's origin in the base frame at joint angles (..., 6).

    Rows 0-2: velocity, metres per radian; rows 3-5: angular velocity.
    """
    frames = link_frames(model, q_rad)
    axes, origins = frames[..., :6, :3, 2], frames[..., :6, :3, 3]
    arms = frames[..., 6:, :3, 3] - origins
    return np.concatenate([np.cross(axes, arms), axes], axis=-1).swapaxes(-1, -2)


def inverse(model: ArmModelName, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
    """All joint vectors (N, 6), each angle in (-pi, pi], whose flange pose is `T_base_flange`; N is 0 to 8.

    At a singular pose endlessly many joint vectors reach it: some of them are given, which may be more than 8, or none
    where the arm is stretched as well. Collisions and joint limits are not looked at; a full turn more or less of any
    joint gives the same pose.
    """
    return inverse_each(model, np.asarray(T_base_flange)[None])[0]


def inverse_each(
    model: ArmModelName, T_base_flange: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """As `inverse`, for poses (N, 4, 4) at once: joint vectors (M, 6), and which pose each of them reaches (M,)."""
    T = np.asarray(T_base_flange, dtype=np.float64)
    found = [_solutions(model, pose) for pose in T]
    which = np.repeat(np.arange(len(T)), [len(q) for q in found])
    q = np.concatenate([np.zeros((0, 6)), *found])
    error = _pose_error(T[which], link_frames(model, q)[:, 6])
    for _ in range(12):
        rough = np.flatnonzero(np.abs(error).max(axis=1) > 1e-11)
        if not len(rough):
            break
        q[rough] += (np.linalg.pinv(jacobian(model, q[rough]), rcond=1e-5) @ error[rough, :, None])[..., 0]
        error[rough] = _pose_error(T[which[rough]], link_frames(model, q[rough])[:, 6])
    good = np.abs(error).max(axis=1) < POSE_TOLERANCE
    q, which = _wrapped(q[good]), which[good]
    new = _new(q, which)
    return q[new], which[new]


def _solutions(model: ArmModelName, T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Joint vectors (N, 6) that reach a pose beside `T`."""
    solver, R_straight = _solver(model)
    for nudges in _NUDGES:
        beside = [T @ nudge for nudge in nudges]
        # Lists are taken column by column.
        asked = [((pose[:3, :3] @ R_straight.T).T.tolist(), pose[:3, 3].tolist()) for pose in beside]
        found = [q for R, t in asked for q, is_nearest_only in solver.get_ik(R, t) if not is_nearest_only]
        q = np.array(found, dtype=np.float64).reshape(-1, 6)
        q = q[np.isfinite(q).all(axis=1)]
        if len(q):
            return q
    return np.zeros((0, 6))


@cache
def _solver(model: ArmModelName) -> tuple[Robot, NDArray[np.float64]]:
    """The solver of an arm whose joints 2 to 4 are parallel and 5 and 6 meet; the flange's turn (3, 3) with all joints
    at zero, which the solver counts from."""
    straight = link_frames(model, np.zeros(6))
    origins = straight[:, :3, 3]
    links = np.diff(origins, axis=0, prepend=origins[:1] * 0.0)
    robot = Robot.three_parallel_two_intersecting(straight[:6, :3, 2].tolist(), links.tolist())
    return robot, straight[6, :3, :3]


def _pose_error(T: NDArray[np.float64], reached: NDArray[np.float64]) -> NDArray[np.float64]:
    """What leads from poses (N, 4, 4) to others: shifts and small turns (N, 6)."""
    turn = T[:, :3, :3] @ reached[:, :3, :3].swapaxes(1, 2)
    skew = 0.5 * (turn - turn.swapaxes(1, 2))
    turns = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)
    return np.concatenate([T[:, :3, 3] - reached[:, :3, 3], turns], axis=1)


def _new(q: NDArray[np.float64], which: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether no joint vector (N, 6) shortly before it reaches the same pose in the same way."""
    new = np.ones(len(q), dtype=np.bool_)
    for back in range(1, 16):
        same = np.abs(_wrapped(q[back:] - q[:-back])).max(axis=1, initial=0.0) < SAME_SOLUTION_RAD
        new[back:] &= ~(same & (which[back:] == which[:-back]))
    return new


def _wrapped(q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles in (-pi, pi]."""
    return np.pi - np.mod(np.pi - q, 2 * np.pi)
