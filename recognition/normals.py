"""Normal vector estimation (section II.D)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.errors import TooCrowdedError
from recognition.outlier_filter import inliers
from recognition.parameters import ChainParameters
from recognition.point_cloud import as_open3d
from recognition.preprocess import TargetCloud

RADIUS_SHARE = 0.6
"""Neighbourhood of the PCA as a share of r. The paper gives none. Measured on simulated scans: with r the string's
own curvature flattens the normals and the centre line comes out 0.4 mm low; much less than this and noise rules."""
MAX_NEIGHBOURS = 60
"""More neighbours than this change a normal no further and only cost time."""
MAX_POINTS = 100_000
"""Evenly spread points that one view may have; a metre of string has about 8,000."""
VOXEL_SHARE = 1 / 4
"""Points are averaged in voxels of this share of r: pixels that fall closer together repeat one another's error."""


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
    """The points of `target`, evenly spread and without outliers, with normals turned to the camera.

    Normals are by PCA over the neighbours within 0.6 r, on the camera's side.

    Raises:
        TooCrowdedError: more points than strings have.
    """
    import open3d as o3d

    points = np.asarray(as_open3d(target.points).voxel_down_sample(parameters.r * VOXEL_SHARE).points)
    if len(points) > MAX_POINTS:
        raise TooCrowdedError(
            f"view {target.view} has {len(points)} points above the table, more than {MAX_POINTS}: "
            "check the camera, the table's height, the workspace and the string's radius"
        )
    points = points[inliers(points)]
    cloud = as_open3d(points)
    cloud.estimate_normals(
        o3d.geometry.KDTreeSearchParamHybrid(radius=RADIUS_SHARE * parameters.r, max_nn=MAX_NEIGHBOURS)
    )
    cloud.orient_normals_towards_camera_location(target.viewpoint)
    return NormalCloud(target.view, points, np.asarray(cloud.normals), target.T_levelling)
