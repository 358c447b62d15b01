"""Poses of the camera during a scan or a calibration with the collision-free tour through them, and reach of grasps.

In: the settings, the hand-eye calibration and the joint angles; for the reach also flange poses of grasps. Out: a
`ViewpointPlan`, or a `GraspReach` for each grasp. Nothing here moves the arm.
"""
