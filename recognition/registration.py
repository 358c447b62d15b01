"""Merging the views into one cloud: ICP that starts from the hand-eye poses (section II.E)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from calibration.transforms import from_rotation_vector, inverse, rotation_angle, transform_points
from recognition.errors import TooCrowdedError
from recognition.model import ViewQuality
from recognition.normals import NormalCloud
from recognition.outlier_filter import inliers
from recognition.parameters import ChainParameters
from recognition.point_cloud import as_open3d

POSE_SIGMA = np.repeat([0.003, 0.001], 3)
"""One sigma of a view's pose as robot and calibration allow it: rotation (3, radians), translation (3, metres)."""
MIN_MATCHES = 50
"""Fewer matched points than this decide nothing."""
SURFACE_SIGMA_M = 0.0005
"""One sigma of a measured surface point along the normal."""
INDEPENDENT_SHARE = 0.02
"""Depth errors are correlated over neighbouring pixels: of a hundred points about two speak for themselves."""
MAX_CORRECTION_SIGMA = 4.0
"""A correction larger than this many sigma of the prior is not a correction but a wrong match."""
MAX_POINTS = 150_000
"""Merged points taken, of which a metre of string has about 10,000: what comes after grows with their neighbours."""
VOXEL_SHARE = 1 / 3
"""The merged cloud is thinned to voxels of this share of r: eight views overlap and say the same many times."""


@dataclass(frozen=True, eq=False)
class Registration:
    """The combined point cloud with normal vectors."""

    points: NDArray[np.float64]
    """(N, 3), base frame, outliers removed, at most one a voxel."""
    normals: NDArray[np.float64]
    """(N, 3), unit length."""
    clouds: tuple[NormalCloud, ...]
    """Each used view's points as registered."""
    views: tuple[ViewQuality, ...]
    """For each used view how it fitted and how far it was corrected."""


def register(clouds: Sequence[NormalCloud], parameters: ChainParameters) -> Registration:
    """Merges the views one after the other by point-to-plane ICP, the fullest first.

    Each view is aligned with all before it. Plain sequential ICP slides along the string, piles up errors, and
    makes the first view's pose error everybody's. So each correction is weighed against the hand-eye pose
    (`correction_onto`), and in the end all are taken relative to their mean: the merged cloud stays where the
    hand-eye poses of all views together put it.
    """
    order = sorted(clouds, key=lambda cloud: (-len(cloud.points), cloud.view))
    centre = np.vstack([cloud.points for cloud in order]).mean(axis=0)
    twists = [np.zeros(6)]
    placed = [order[0]]
    for cloud in order[1:]:
        twists.append(correction_onto(placed, cloud, centre, parameters))
        placed.append(corrected(cloud, twists[-1], centre))
    common = np.mean(twists, axis=0)
    twists = [twist - common for twist in twists]
    placed = [corrected(cloud, twist, centre) for cloud, twist in zip(order, twists, strict=True)]
    points, normals = merge(placed, parameters)
    qualities = [_quality(cloud, points, parameters) for cloud in placed]
    by_view = sorted(range(len(order)), key=lambda i: order[i].view)
    return Registration(points, normals, tuple(placed[i] for i in by_view), tuple(qualities[i] for i in by_view))


def merge(
    clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and normals, (N, 3) each, of all clouds together: outliers removed, averaged in voxels."""
    points = np.vstack([cloud.points for cloud in clouds])
    normals = np.vstack([cloud.normals for cloud in clouds])
    kept = inliers(points)
    thinned = as_open3d(points[kept], normals[kept]).voxel_down_sample(parameters.r * VOXEL_SHARE)
    points, normals = np.asarray(thinned.points), np.asarray(thinned.normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Opposite normals in one voxel cancel: such a point has no side.
    sided = length[:, 0] > 0.1
    if sided.sum() > MAX_POINTS:
        raise TooCrowdedError(
            f"the views together have {sided.sum()} points above the table, more than {MAX_POINTS}: "
            "check the table's height, the workspace and the string's radius"
        )
    return points[sided], normals[sided] / length[sided]


def correction_onto(
    placed: Sequence[NormalCloud],
    cloud: NormalCloud,
    centre: NDArray[np.float64],
    parameters: ChainParameters,
) -> NDArray[np.float64]:
    """(6,) rotation vector and translation about `centre` (3,) that bring `cloud` onto the `placed` ones.

    ICP's answer x is weighed against the hand-eye pose: with H the information of its point-to-plane matches
    and P that of the pose, the correction is (H + P)^-1 H x. Along directions in which the string can slide
    freely H is zero and the pose stays. Zero where ICP finds too few matches, a correction beyond what
    calibration can explain, or one that does not bring the surfaces closer.
    """
    import open3d as o3d

    registration = o3d.pipelines.registration
    normals = np.vstack([other.normals for other in placed])
    target = as_open3d(np.vstack([other.points for other in placed]) - centre, normals)
    source = as_open3d(cloud.points - centre)
    found = registration.registration_icp(
        source,
        target,
        parameters.r,
        np.eye(4),
        registration.TransformationEstimationPointToPlane(registration.TukeyLoss(parameters.r / 2)),
        registration.ICPConvergenceCriteria(max_iteration=30),
    )
    matches = np.asarray(found.correspondence_set)
    if len(matches) < MIN_MATCHES:
        return np.zeros(6)
    x = np.concatenate([Rotation.from_matrix(found.transformation[:3, :3]).as_rotvec(), found.transformation[:3, 3]])
    matched_normals = normals[matches[:, 1]]
    J = np.hstack([np.cross(cloud.points[matches[:, 0]] - centre, matched_normals), matched_normals])
    H = J.T @ J * (INDEPENDENT_SHARE / SURFACE_SIGMA_M**2)
    x = np.linalg.solve(H + np.diag(POSE_SIGMA**-2.0), H @ x)
    surface = (KDTree(np.asarray(target.points)), normals)
    before = _misfit(cloud.points - centre, *surface, parameters)
    after = _misfit(transform_points(from_rotation_vector(x[3:], x[:3]), cloud.points - centre), *surface, parameters)
    if after > before or (np.abs(x) / POSE_SIGMA).max() > MAX_CORRECTION_SIGMA:
        return np.zeros(6)
    return np.asarray(x, dtype=np.float64)


def _misfit(
    points: NDArray[np.float64], tree: KDTree, normals: NDArray[np.float64], parameters: ChainParameters
) -> float:
    """Mean distance of `points` (N, 3) from the planes of their nearest surface points, metres.

    Points without a surface point within r count as r away, so that nothing is won by leaving the surface.
    """
    nearest = np.asarray(tree.query(points, distance_upper_bound=parameters.r)[1])
    matched = nearest < tree.n
    way = points[matched] - tree.data[nearest[matched]]
    to_plane = np.abs((way * normals[nearest[matched]]).sum(axis=1))
    return float((to_plane.sum() + parameters.r * (~matched).sum()) / len(points))


def corrected(cloud: NormalCloud, twist: NDArray[np.float64], centre: NDArray[np.float64]) -> NormalCloud:
    """`cloud` moved by the rotation vector and translation `twist` (6,) about `centre` (3,)."""
    T = from_rotation_vector(twist[3:], twist[:3])
    T[:3, 3] += centre - T[:3, :3] @ centre
    return replace(
        cloud,
        points=transform_points(T, cloud.points),
        normals=cloud.normals @ T[:3, :3].T,
        T_correction=T @ cloud.T_correction,
    )


def _quality(cloud: NormalCloud, merged: NDArray[np.float64], parameters: ChainParameters) -> ViewQuality:
    distance, _ = KDTree(merged).query(cloud.points, distance_upper_bound=parameters.r)
    matched = distance[np.isfinite(distance)]
    middle = cloud.points.mean(axis=0)
    before = transform_points(inverse(cloud.T_correction), middle)
    return ViewQuality(
        index=cloud.view,
        used=True,
        reason=None,
        points=len(cloud.points),
        fitness=len(matched) / len(distance),
        rms_m=float(np.sqrt(np.mean(matched**2))) if len(matched) else None,
        correction_m=float(np.linalg.norm(middle - before)),
        correction_rad=rotation_angle(cloud.T_correction),
    )
