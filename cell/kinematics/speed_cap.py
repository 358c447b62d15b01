"""Speed of a joint move under the speed limit of the flange.

A moveJ follows a straight line in joint space. Its speed is that of the leading joint, which turns farthest.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.config.arm_models import ArmModelName
from cell.kinematics.ur_kinematics import ARMS, flange_speeds, joint_speeds

_STEP_RAD = 0.05
"""Sum of all joint motions between two samples of the line."""
_SAMPLES_AT_ONCE = 8192
"""Number of samples that are computed together, which fit into the cache of a processor."""


def capped_speed(
    model: ArmModelName,
    q_from: ArrayLike,
    q_to: ArrayLike,
    speed_rad_s: float,
    flange_speed_m_s: float,
) -> float:
    """Return the speed of the leading joint, rad/s, for a straight joint move.

    Args:
        model: Model of the arm.
        q_from: Joint angles (6,) at the start, rad.
        q_to: Joint angles (6,) at the target, rad.
        speed_rad_s: Configured speed of the leading joint. The joints' own limits hold too.
        flange_speed_m_s: Speed limit of the flange's origin, which holds on the whole line. The limit between two
            samples makes the move about 1 % slower than necessary.
    """
    start, end = (np.asarray(q, dtype=np.float64)[None] for q in (q_from, q_to))
    return float(capped_speeds(model, start, end, speed_rad_s, flange_speed_m_s)[0])


def capped_speeds(
    model: ArmModelName,
    q_from: NDArray[np.float64],
    q_to: NDArray[np.float64],
    speed_rad_s: float,
    flange_speed_m_s: float,
) -> NDArray[np.float64]:
    """Return the speeds (N,) of several moves, as `capped_speed`, from joint angles (N, 6) to others (N, 6)."""
    turn = np.abs(q_to - q_from)
    furthest = turn.max(axis=1)
    moves = furthest > 0
    share = turn / np.where(moves, furthest, 1.0)[:, None]
    share[~moves] = 1.0  # all joints' limits hold for a move without length
    by_joints = (joint_speeds(model) / share.clip(min=1e-12)).min(axis=1)
    by_flange = np.full(len(turn), np.inf)
    by_flange[moves] = flange_speed_m_s * furthest[moves] / _max_flange_travels(model, q_from[moves], q_to[moves])
    return np.minimum(np.minimum(by_joints, by_flange), speed_rad_s)


def max_flange_travel(model: ArmModelName, q_from: ArrayLike, q_to: ArrayLike) -> float:
    """Return an upper bound of the flange's speed for a move of unit duration along the straight joint line, metres.

    The bound is close to the true maximum.
    """
    start, end = (np.asarray(q, dtype=np.float64)[None] for q in (q_from, q_to))
    return float(_max_flange_travels(model, start, end)[0])


def _max_flange_travels(
    model: ArmModelName, q_from: NDArray[np.float64], q_to: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the bounds (N,) of `max_flange_travel` for several lines (N, 6)."""
    turn = q_to - q_from
    total = np.abs(turn).sum(axis=1)
    steps = np.ceil(total / _STEP_RAD).astype(np.int64) + 1
    fastest = np.zeros(len(turn))
    ends = np.cumsum(steps + 1)
    cuts = np.searchsorted(ends, np.arange(_SAMPLES_AT_ONCE, ends[-1], _SAMPLES_AT_ONCE)) if len(ends) else []
    for lines in np.split(np.arange(len(turn)), np.unique(cuts)):
        if len(lines):
            fastest[lines] = _fastest_samples(model, q_from[lines], turn[lines], steps[lines])
    # Between two samples a velocity is within h^2 / 8 max |v''| of the chord. Each derivative along the line adds at
    # most a factor of the sum of the joint motions, with a lever no longer than the stretched arm.
    arm = ARMS[model]
    lever = float(np.abs(arm.a_m).sum() + np.abs(arm.d_m).sum())
    return fastest + lever * total**3 / (8 * steps**2)


def _fastest_samples(
    model: ArmModelName, q_from: NDArray[np.float64], turn: NDArray[np.float64], steps: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the largest speed (N,) of the flange at `steps` (N,) equal steps of each line, in unit duration."""
    line = np.repeat(np.arange(len(turn)), steps + 1)
    first = np.cumsum(steps + 1) - steps - 1
    share = (np.arange(len(line)) - first[line]) / steps[line]
    turns = turn[line]
    return np.maximum.reduceat(flange_speeds(model, q_from[line] + share[:, None] * turns, turns), first)
