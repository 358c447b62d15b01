"""Preprocessing of single views: from a depth image to the points of the strings, with normal vectors.

The input is a depth image with its camera pose, the scene and the parameters. The output is the target cloud (points in
the workspace and above the table) and a cloud with unit normals, both in the base frame. This package does not export
`normals`, so programs that need only `Scene` start without scipy.
"""

from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, deproject, preprocess

__all__ = ["DepthView", "Scene", "TargetCloud", "deproject", "preprocess"]
