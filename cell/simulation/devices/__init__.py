"""Simulated camera on the flange of an arm, above a simulated table.

In: the settings of the cell and the flange pose. Out: depth and intensity images as messages of a depthai pipeline, and
the truth of the scene.
"""
