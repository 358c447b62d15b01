"""Grasps of a parallel gripper.

Chains, crossings, the measured surface and a `Gripper` go in. Grasps along all chains come out, the best first, with a
warning for each chain without one. `recognition.grasping.grasp_planner.find_grasps` is the stage; it is not exported
here, so that the configuration, which needs `Gripper` alone, starts without scipy.
"""

from recognition.grasping.gripper import Gripper

__all__ = ["Gripper"]
