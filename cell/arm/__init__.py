"""The arm: a Universal Robots controller, reached through ur_rtde in a child process.

In: the arm settings and joint targets. Out: `UrArm`, whose moves are watched until the arm is at rest, and errors that
say why it is not.
"""
