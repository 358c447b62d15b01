"""Where the camera stands during a scan or a calibration, and the collision-free tour through these poses.

In: the settings, the hand-eye calibration and the joint angles. Out: a `ViewpointPlan`. Nothing here moves the arm.
"""
