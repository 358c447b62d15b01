"""The simulated camera and what it sees.

In: the settings and the arm's pose. Out: depth frames in the form in which depthai delivers them.
"""
