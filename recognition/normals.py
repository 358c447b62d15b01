"""Normal vector estimation (section II.D)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.point_cloud import as_open3d

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


def estimate_normals(
    view: int, points: NDArray[np.float64], viewpoint: NDArray[np.float64], parameters: ChainParameters
) -> NormalCloud:
    """Normals of `points` (N, 3) by PCA over the neighbours within r, turned towards `viewpoint` (3,).

    The radius is ours (the paper gives none): r sees a sixth of the string's circumference to either side,
    enough to drown pixel noise, not so much that the curvature flattens the normals.
    """
    import open3d as o3d

    cloud = as_open3d(points)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=parameters.r, max_nn=MAX_NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(np.asarray(viewpoint, dtype=np.float64))
    return NormalCloud(view=view, points=points, normals=np.asarray(cloud.normals))
