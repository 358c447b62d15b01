"""Flange poses of a grasp: pre-grasp, grasp and retreat.

Poses of grasps and a gripper go in; poses of the arm's flange come out. The tool centre point (TCP) is on the flange's
z axis, in the plane of the fingertips' ends, midway between the two fingers. Its x axis is the closing direction and
its z axis points out of the gripper.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recognition.grasping.gripper import Gripper

APPROACH_MARGIN_M = 0.01
"""Distance of the fingertips, at the pre-grasp, from the highest thing that may lie under the palm of the grasp."""
LIFT_M = 0.06
"""Distance by which the gripper is lifted after a grasp, along its approach direction, metres."""


@dataclass(frozen=True, eq=False)
class FlangePoses:
    """Flange poses of N grasps, (N, 4, 4) each, as `T_base_flange`.

    A grasp that is turned by pi about its approach direction is the same grasp. `turned` returns its poses.
    """

    pregrasp: NDArray[np.float64]
    """Poses in front of the grasp, back along the approach direction. The gripper opens here."""
    grasp: NDArray[np.float64]
    """Poses at which the fingers close."""
    retreat: NDArray[np.float64]
    """Poses after the lift, back along the approach direction, where the planner has found free space."""

    def turned(self) -> "FlangePoses":
        """Return the poses turned by pi about the flange's z axis. They hold the string in the same way."""
        half_turn = np.diag((-1.0, -1.0, 1.0, 1.0))
        return FlangePoses(self.pregrasp @ half_turn, self.grasp @ half_turn, self.retreat @ half_turn)


def T_flange_tcp(gripper: Gripper) -> NDArray[np.float64]:
    """Return the pose (4, 4) of the tool centre point on the flange.

    Args:
        gripper: Gripper with its length and its rotation on the flange.
    """
    cosine = np.cos(gripper.mounting_rotation_rad)
    sine = np.sin(gripper.mounting_rotation_rad)
    T = np.eye(4)
    T[:2, :2] = [[cosine, -sine], [sine, cosine]]
    T[2, 3] = gripper.length_m
    return T


def approach_distance_m(gripper: Gripper) -> float:
    """Return the distance from the pre-grasp to the grasp, metres.

    The planner keeps the palm clear of everything on its whole approach. So nothing beside the string is higher above
    the fingertips of the grasp than the depth of the fingers, and one finger depth farther back the fingertips are
    above all of it. It is not less than the lift, so that a checked descent covers the retreat, too.

    Args:
        gripper: Gripper with the depth of its fingers.
    """
    return max(gripper.finger_depth_m + APPROACH_MARGIN_M, LIFT_M)


def flange_poses(
    T_base_grasp: NDArray[np.float64],
    reach_m: ArrayLike,
    gripper: Gripper,
    approach_m: float | None = None,
    lift_m: float = LIFT_M,
) -> FlangePoses:
    """Return the flange poses of grasps.

    Args:
        T_base_grasp: (N, 4, 4) poses of the grasps: z along the approach, x along the closing direction, origin on the
            centre line.
        reach_m: (N,) distances of the fingertips beyond the centre line, metres.
        gripper: Gripper on the flange.
        approach_m: Distance from the pre-grasp to the grasp along the approach. None means `approach_distance_m`.
        lift_m: Distance of the lift, along the approach.

    Returns:
        The poses of the flange, one of the two equivalent turns about the approach direction.
    """
    T_tcp_flange = np.linalg.inv(T_flange_tcp(gripper))
    if approach_m is None:
        approach_m = approach_distance_m(gripper)
    T_grasp_tcp = np.broadcast_to(np.eye(4), T_base_grasp.shape).copy()
    T_grasp_tcp[:, 2, 3] = reach_m
    grasp = T_base_grasp @ T_grasp_tcp @ T_tcp_flange
    pregrasp = grasp.copy()
    pregrasp[:, :3, 3] -= approach_m * grasp[:, :3, 2]
    retreat = grasp.copy()
    retreat[:, :3, 3] -= lift_m * grasp[:, :3, 2]
    return FlangePoses(pregrasp, grasp, retreat)
