"""Between our arrays and Open3D's clouds. The only importer of Open3D in recognition, and only when called."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import open3d as o3d


def as_open3d(points: NDArray[np.float64], normals: NDArray[np.float64] | None = None) -> "o3d.geometry.PointCloud":
    """Points (N, 3), with normals (N, 3) where given, as an Open3D cloud."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.ascontiguousarray(points)))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(np.ascontiguousarray(normals))
    return cloud
