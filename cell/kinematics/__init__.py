"""Kinematics and collision checks of the supported arms.

In: joint angles or flange poses. Out: flange poses, joint solutions, and whether a posture or a path is free.
"""
