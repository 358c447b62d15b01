"""Normal vector estimation (section II.D)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.outlier_filter import inliers
from recognition.parameters import ChainParameters
from recognition.point_cloud import as_open3d
from recognition.preprocess import TargetCloud

MAX_NEIGHBOURS = 60
"""More neighbours than this change a normal no further and only cost time."""


@dataclass(frozen=True, eq=False)
class NormalCloud:
    """The paper's "point cloud with NV"."""

    view: int
    """Index of the view it comes from."""
    points: NDArray[np.float64]
    """(N, 3), base frame."""
    normals: NDArray[np.float64]
    """(N, 3), unit length, on the side of the camera."""
    T_correction: NDArray[np.float64]
    """(4, 4), base to base: how far the view has been moved from its hand-eye pose."""


def estimate_normals(target: TargetCloud, parameters: ChainParameters) -> NormalCloud:
    """The points of `target` without outliers, with normals by PCA over the neighbours within r, turned to the camera.

    The radius is ours (the paper gives none): r sees a sixth of the string's circumference to either side,
    enough to drown pixel noise, not so much that the curvature flattens the normals.
    """
    import open3d as o3d

    points = target.points[inliers(target.points)]
    cloud = as_open3d(points)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=parameters.r, max_nn=MAX_NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(target.viewpoint)
    return NormalCloud(target.view, points, np.asarray(cloud.normals), target.T_levelling)
