"""Recognise strings by a literal implementation of the paper, which is the baseline for the speed of `recognition`.

The steps follow the text of the paper in its order. Open3D and SciPy compute each step that they have a function for.
The other steps are loops over all points, without optimisation. This module has sections II.A to II.F, III.B and III.C.
The other sections are in `reference_matching` and `reference_reconstruction`.

Source:
    Shirakawa et al.
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
"""Number of neighbours and standard deviation ratio of the statistical outlier filter, common values in Open3D."""
NORMAL_NEIGHBOURS = 30
"""Maximum number of neighbours for the PCA of a normal vector, a common value in Open3D."""

Points = NDArray[np.float64]


def recognise_literally(views: Iterable[DepthView], parameters: ChainParameters, scene: Scene) -> list[Points]:
    """Recognise the strings in `views`.

    Args:
        views: Depth images with their camera poses.
        parameters: Radii and thresholds of Table I.
        scene: Table height and workspace, base frame.

    Returns:
        Ordered points (N, 3) of each string, metres, base frame. The list is empty if no view shows a string.
    """
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
    """Return the point cloud with normal vectors of one view.

    Args:
        view: Depth image with its camera pose.
        parameters: Radii and thresholds of Table I.
        scene: Table height and workspace, base frame.

    Returns:
        `open3d.geometry.PointCloud` of the points above the table, metres, base frame. The normals point towards the
        camera.

    Source:
        Sections II.A to II.D.
    """
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
    """Combine the point clouds of all views.

    Each cloud is registered by point-to-plane ICP to the union of the earlier clouds, and then added to the union.

    Args:
        clouds: `open3d.geometry.PointCloud` of each view, with normals, base frame.
        parameters: Radii and thresholds of Table I. `r` is the maximum distance of corresponding points.

    Returns:
        The combined `open3d.geometry.PointCloud` without outliers.

    Source:
        Section II.E.
    """
    import open3d as o3d

    combined: Any = o3d.geometry.PointCloud(clouds[0])
    for cloud in clouds[1:]:
        registration = o3d.pipelines.registration.registration_icp(
            cloud, combined, parameters.r, np.eye(4), o3d.pipelines.registration.TransformationEstimationPointToPlane()
        )
        combined += o3d.geometry.PointCloud(cloud).transform(registration.transformation)
    return _without_outliers(combined)


def estimate_centre_line(points: Points, normals: Points, parameters: ChainParameters) -> Points:
    """Return the centre line point cloud.

    Args:
        points: Points of the combined cloud (N, 3), metres.
        normals: Unit normal vectors (N, 3), outwards.
        parameters: Radii and thresholds of Table I.

    Returns:
        Centre line points (M, 3) without outliers, metres.

    Source:
        Section II.F, eqs. (1) and (2).
    """
    import open3d as o3d
    from scipy.spatial import KDTree

    c = points - parameters.r * normals
    # One neighbourhood at a time, because the neighbour lists of all points take a gigabyte.
    tree = KDTree(points)
    averaged = np.array([c[tree.query_ball_point(p, 2 * parameters.r)].mean(axis=0) for p in points]).reshape(-1, 3)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(averaged))
    return np.asarray(_without_outliers(cloud).points)


def thin(points: Points, parameters: ChainParameters) -> Points:
    """Return the thinned points (N, 3) of the centre line points (N, 3), section III.B, eq. (3)."""
    from scipy.spatial import KDTree

    tree = KDTree(points)
    return np.array([points[tree.query_ball_point(p, parameters.r_c)].mean(axis=0) for p in points])


def contribution_rates(points: Points, parameters: ChainParameters) -> NDArray[np.float64]:
    """Return the contribution rate (N,) of each thinned point (N, 3), section III.C, eqs. (4) to (6)."""
    from scipy.spatial import KDTree

    tree = KDTree(points)
    rates = np.ones(len(points))
    for i, p in enumerate(points):
        q = points[tree.query_ball_point(p, parameters.r_s)]
        eigenvalues = np.linalg.eigvalsh((q - q.mean(axis=0)).T @ (q - q.mean(axis=0)) / len(q))
        # All eigenvalues of a point without other neighbours are zero. Its rate stays 1.
        if eigenvalues.sum() > 0:
            rates[i] = eigenvalues[-1] / np.abs(eigenvalues).sum()
    return rates


def _without_outliers(cloud: Any) -> Any:
    """Return a cloud after the statistical outlier filter (II.C). A cloud of too few points is returned unchanged."""
    if len(cloud.points) <= OUTLIER_NEIGHBOURS:
        return cloud
    return cloud.remove_statistical_outlier(OUTLIER_NEIGHBOURS, OUTLIER_STD)[0]
