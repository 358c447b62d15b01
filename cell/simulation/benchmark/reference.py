"""The literal baseline: the paper's steps in order, as a careful reader would first write them.

Source: Shirakawa et al., sections II.A to II.F here, the others in `reference_matching` and `reference_reconstruction`.
Open3D and SciPy do what they have a call for. The rest is written as in the text, point by point, on all points.
`recognition` is compared with it.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.benchmark.reference_matching import match_enhanced
from cell.simulation.benchmark.reference_reconstruction import reconstruct
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import DepthView, Scene

OUTLIER_NEIGHBOURS, OUTLIER_STD = 20, 2.0
"""Parameters of the statistical outlier filter, which are Open3D's usual values."""
NORMAL_NEIGHBOURS = 30
"""Number of neighbours for the PCA of a normal vector, which is Open3D's usual value."""

Points = NDArray[np.float64]


def recognise_literally(views: Iterable[DepthView], parameters: ChainParameters, scene: Scene) -> list[Points]:
    """Return the strings in `views` as ordered points (N, 3), metres, base frame, or nothing if nothing is seen."""
    clouds = [cloud for view in views if len((cloud := cloud_with_normals(view, parameters, scene)).points)]
    if not clouds:
        return []
    combined = combine(clouds, parameters)
    centre_line = estimate_centre_line(np.asarray(combined.points), np.asarray(combined.normals), parameters)
    if not len(centre_line):
        return []
    thinned = thin(centre_line, parameters)
    segments, centres = match_enhanced(thinned, contribution_rates(thinned, parameters), parameters)
    return reconstruct([thinned[segment] for segment in segments], thinned[centres], parameters)


def cloud_with_normals(view: DepthView, parameters: ChainParameters, scene: Scene) -> Any:
    """Return the point cloud with normal vectors of one view (II.A to II.D), base frame."""
    import open3d as o3d

    height, width = view.depth.shape
    depth: Any = view.depth
    cloud: Any = o3d.geometry.PointCloud.create_from_depth_image(
        o3d.geometry.Image(depth),
        o3d.camera.PinholeCameraIntrinsic(width, height, view.K),
        np.linalg.inv(view.T_base_camera),
        depth_scale=1.0 / view.depth_unit_m,
        depth_trunc=10.0,
    )
    if scene.workspace_m is not None:
        low, high = np.array(scene.workspace_m, dtype=np.float64).T
        cloud = cloud.crop(o3d.geometry.AxisAlignedBoundingBox(low, high))
    above = np.asarray(cloud.points)[:, 2] > scene.table_z_m + parameters.z_t
    cloud = _without_outliers(cloud.select_by_index(np.flatnonzero(above)))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=parameters.r, max_nn=NORMAL_NEIGHBOURS))
    cloud.orient_normals_towards_camera_location(view.T_base_camera[:3, 3])
    return cloud


def combine(clouds: list[Any], parameters: ChainParameters) -> Any:
    """Return the combined point cloud (II.E). Each cloud is registered by ICP to those before it and added."""
    import open3d as o3d

    combined: Any = o3d.geometry.PointCloud(clouds[0])
    for cloud in clouds[1:]:
        registration = o3d.pipelines.registration.registration_icp(
            cloud, combined, parameters.r, np.eye(4), o3d.pipelines.registration.TransformationEstimationPointToPlane()
        )
        combined += o3d.geometry.PointCloud(cloud).transform(registration.transformation)
    return _without_outliers(combined)


def estimate_centre_line(points: Points, normals: Points, parameters: ChainParameters) -> Points:
    """Return the centre line point cloud (II.F) by eqs. (1) and (2)."""
    import open3d as o3d
    from scipy.spatial import KDTree

    c = points - parameters.r * normals
    # one neighbourhood at a time, because the lists of all points take a gigabyte
    tree = KDTree(points)
    averaged = np.array([c[tree.query_ball_point(p, 2 * parameters.r)].mean(axis=0) for p in points]).reshape(-1, 3)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(averaged))
    return np.asarray(_without_outliers(cloud).points)


def thin(points: Points, parameters: ChainParameters) -> Points:
    """Return the thinned point cloud (III.B), eq. (3)."""
    from scipy.spatial import KDTree

    tree = KDTree(points)
    return np.array([points[tree.query_ball_point(p, parameters.r_c)].mean(axis=0) for p in points])


def contribution_rates(points: Points, parameters: ChainParameters) -> NDArray[np.float64]:
    """Return the contribution rate (N,) of each thinned point (III.C), eqs. (4) to (6)."""
    from scipy.spatial import KDTree

    tree = KDTree(points)
    rates = np.ones(len(points))
    for i, p in enumerate(points):
        q = points[tree.query_ball_point(p, parameters.r_s)]
        eigenvalues = np.linalg.eigvalsh((q - q.mean(axis=0)).T @ (q - q.mean(axis=0)) / len(q))
        # a point without other neighbours has no extent
        if eigenvalues.sum() > 0:
            rates[i] = eigenvalues[-1] / np.abs(eigenvalues).sum()
    return rates


def _without_outliers(cloud: Any) -> Any:
    """Return a cloud after the statistical outlier filter (II.C)."""
    if len(cloud.points) <= OUTLIER_NEIGHBOURS:
        return cloud
    return cloud.remove_statistical_outlier(OUTLIER_NEIGHBOURS, OUTLIER_STD)[0]
