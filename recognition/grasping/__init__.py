"""Grasps of a parallel gripper.

Chains, crossings, the measured surface and a `Gripper` go in. Grasps along all chains come out, the best first, with a
warning for each chain without a grasp. The function of this stage is `recognition.grasping.grasp_planner.find_grasps`.
It is not exported here, because the configuration imports `Gripper` and must not load scipy.
"""

from recognition.grasping.gripper import Gripper

__all__ = ["Gripper"]
