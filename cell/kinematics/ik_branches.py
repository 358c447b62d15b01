"""Collision-free inverse kinematics solutions of flange poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.kinematics.collision import CollisionModel
from cell.kinematics.ur_kinematics import ARMS, inverse_each, jacobian

USED_LIMIT_RAD = 0.97 * 2 * np.pi
"""Largest joint angle that is used, also for an endless wrist, because the camera's cable turns with it."""
MIN_SINGULAR_VALUE = 0.04
"""Smallest singular value of the Jacobian, metres and radians mixed. Below it, wrist, elbow or shoulder are near a
singularity, where small motions of the camera need large joint motions."""

OUT_OF_REACH = "out of the arm's reach"
TOO_NEAR = "too near the axis of the arm's base"
SINGULAR = "the arm would be stretched, or its wrist straight, near a singular posture"


@dataclass(frozen=True, eq=False)
class IkSolutions:
    """Joint angles that reach flange poses, and why some poses have none."""

    q_rad: NDArray[np.float64]
    """Joint angles (M, 6), each in (-pi, pi]."""
    which: NDArray[np.int64]
    """Index (M,) of the pose that each solution reaches."""
    reasons: tuple[str | None, ...]
    """For each pose, why it has no solution, or None if it has one."""

    def of(self, pose: int) -> NDArray[np.float64]:
        """Return the joint angles (K, 6) that reach this pose."""
        return self.q_rad[self.which == pose]


def find_ik_solutions(collisions: CollisionModel, T_base_flange: NDArray[np.float64]) -> IkSolutions:
    """Return all joint angles for flange poses that are far from singularities and keep all clearances.

    Args:
        collisions: Collision model of the cell.
        T_base_flange: Flange poses (N, 4, 4).
    """
    q, which = inverse_each(collisions.model, T_base_flange)
    arm = ARMS[collisions.model]
    wrist = T_base_flange[:, :2, 3] - arm.d_m[5] * T_base_flange[:, :2, 2]
    reasons: list[str | None] = [TOO_NEAR if r < arm.d_m[3] else OUT_OF_REACH for r in np.linalg.norm(wrist, axis=1)]
    agile = np.linalg.svd(jacobian(collisions.model, q), compute_uv=False)[:, -1] >= MIN_SINGULAR_VALUE
    for pose in np.unique(which):
        reasons[pose] = SINGULAR
    q, which = q[agile], which[agile]
    short = collisions.gaps(q) - collisions.clearances
    worst = short.min(axis=1)
    for pose in np.unique(which):
        best = np.flatnonzero(which == pose)[worst[which == pose].argmax()]
        reasons[pose] = None if worst[best] >= 0 else collisions.contacts[short[best].argmin()]
    free = worst >= 0
    return IkSolutions(q[free], which[free], tuple(reasons))


def with_full_turns(q_rad: NDArray[np.float64], reference_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return joint angles with every joint in the turn nearest to a reference, and the last joint in all turns.

    Args:
        q_rad: Joint angles (M, 6).
        reference_rad: Reference joint angles (6,).

    Returns:
        Joint angles (K, 6), K from M to 3 M.
    """
    turns = 2 * np.pi * np.arange(-1, 2)
    choices = q_rad[:, :, None] + turns
    allowed = np.abs(choices) <= USED_LIMIT_RAD
    off = np.where(allowed, np.abs(choices - reference_rad[:, None]), np.inf)
    near = np.take_along_axis(choices, off.argmin(axis=2)[:, :, None], axis=2)[:, :, 0]
    result = np.repeat(near[:, None], len(turns), axis=1)
    result[:, :, 5] = choices[:, 5]
    return result[allowed[:, 5]]
