"""Preprocessing of single views: from a depth image to the points of the strings, with normal vectors.

A depth image with its camera pose, the scene and the parameters go in. A target cloud (points in the workspace and
above the table) and a cloud with unit normal vectors come out, both in the base frame. `normals` is not exported here,
so that programs that need `Scene` alone start without scipy.
"""

from recognition.preprocessing.target_cloud import DepthView, Scene, TargetCloud, deproject, preprocess

__all__ = ["DepthView", "Scene", "TargetCloud", "deproject", "preprocess"]
