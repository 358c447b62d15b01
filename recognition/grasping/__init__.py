"""Grasps of a parallel gripper.

Chains, crossings, the measured surface and a `Gripper` go in. Grasps along all chains come out, with the poses of the
flange that carry them out, and a note on each chain without a grasp. The function of this stage is
`recognition.grasping.grasping.plan_grasps`. It is not exported here, because the configuration imports `Gripper` and
must not load scipy.
"""

from recognition.grasping.gripper import Gripper

__all__ = ["Gripper"]
