"""Joint registration of all views, with the hand-eye poses as initial poses and as prior (section II.E).

The paper registers one cloud after the other by ICP. Pairwise ICP slides along the string, accumulates errors, and
applies the pose error of the first view to all other views.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from recognition.model.findings import Finding, finding
from recognition.model.quality import ExclusionReason, ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import (
    ComparedViews,
    Correspondences,
    compared_views,
    find_correspondences,
)
from recognition.registration.free_space_check import find_inconsistent_views
from recognition.registration.fusion import merge_clouds
from recognition.registration.hand_eye_error import HandEyeErrorEstimate, estimate_hand_eye_error
from recognition.registration.multiview_icp import Alignment, align_views, correction_transforms
from recognition.registration.pose_prior import PoseSigmas, pose_prior
from recognition.registration.view_fitness import evaluate_fitness

MAX_HAND_EYE_ERROR_SIGMA = 5.0
"""Maximum Mahalanobis norm of the 6D hand-eye error. A larger error means that the calibration has drifted. A
good calibration exceeds the limit in one of three thousand scans."""
EXPECTED_ROBOT_RMS = 1.6
"""Expected rms of the Mahalanobis norms of the 6D robot errors, if the sigmas are right. It is less than sqrt(6),
because the data do not constrain all directions, and the estimate is zero in the other directions."""
MAX_ROBOT_RMS_RATIO = 1.3
"""Maximum ratio of the rms of the robot errors to `EXPECTED_ROBOT_RMS`. Above it, the sigmas are increased."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Merged cloud of all views, with the corrected views and the covariance of their poses."""

    points: NDArray[np.float64]
    """(N, 3) points of the merged cloud, metres, base frame, at most one point in each voxel."""
    normals: NDArray[np.float64]
    """(N, 3) unit normals of the points."""
    clouds: tuple[NormalCloud, ...]
    """Registered cloud of each used view."""
    views: tuple[ViewQuality, ...]
    """Fitness and correction of each used view, and the reason for each excluded view, sorted by view index."""
    centre: NDArray[np.float64]
    """(3,) point about which the corrections rotate, metres, base frame."""
    covariance: NDArray[np.float64]
    """(6 V, 6 V) covariance of the remaining pose errors of `clouds`. Each view has a rotation (rad) about `centre`,
    then a translation (m)."""
    hand_eye_drift: Finding | None = None
    """Finding on a hand-eye error that is larger than a good calibration allows. It names no chains yet."""
    hand_eye_error: HandEyeErrorEstimate | None = None
    """Hand-eye error estimated from the views; None if the surfaces do not constrain the poses."""


NO_REGISTRATION = Registration(
    points=np.empty((0, 3)),
    normals=np.empty((0, 3)),
    clouds=(),
    views=(),
    centre=np.zeros(3),
    covariance=np.empty((0, 0)),
)
"""Registration of no views."""


def register(
    clouds: Sequence[NormalCloud],
    parameters: ChainParameters,
    correspondences: Sequence[Correspondences] | None = None,
    sigmas: PoseSigmas | None = None,
    table_z_m: float | None = None,
) -> Registration:
    """Align all views to each other and to the given poses, and merge them into one cloud.

    Views that contradict the other views are excluded, and the remaining views are aligned again.

    Args:
        clouds: Points with normals of each view, at the given pose, base frame, in the order of arrival.
        parameters: Method parameters; uses the radius r.
        correspondences: Correspondences of each view with the earlier views of `compared_views`, from
            `find_correspondences`. None: they are searched here.
        sigmas: Standard deviations of the pose errors. None: the defaults of `PoseSigmas`.
        table_z_m: Height of the table plane, metres, base frame. A depth far below it is an error. None: unknown.

    Returns:
        The merged cloud, the registered views and the quality of each view.

    Raises:
        ContradictingViewsError: At least half of the views would have to be excluded.
        DepthNoiseError: The same, but the depth scatters so much that noise explains it.
        TooCrowdedError: The merged cloud has too many points for a scene of strings.

    Source:
        Section II.E. The joint least squares, the prior and the checks are not in the paper.
    """
    sigmas = sigmas or PoseSigmas()
    views = _sort_views(clouds, correspondences, parameters)
    centre = np.vstack([cloud.points for cloud in views.clouds]).mean(axis=0)
    alignment, registered = _align(views, centre, parameters, sigmas)

    reasons = find_inconsistent_views(registered, alignment.robot_errors, parameters, table_z_m)
    excluded_qualities = _excluded_qualities(views.clouds, reasons)
    if reasons:
        views = views.without(reasons)
        alignment, registered = _align(views, centre, parameters, sigmas)

    # The drift is judged by the given sigmas.
    drift = _find_drift(alignment.hand_eye_error, sigmas)
    looser_sigmas = _loosen_sigmas(sigmas, alignment.robot_errors)
    if looser_sigmas is not None:
        sigmas = looser_sigmas
        alignment, registered = _align(views, centre, parameters, sigmas)

    points, normals = merge_clouds(registered, parameters)
    qualities = evaluate_fitness(views.clouds, registered, parameters) + excluded_qualities
    return Registration(
        points=points,
        normals=normals,
        clouds=tuple(registered),
        views=tuple(sorted(qualities, key=lambda view: view.index)),
        centre=centre,
        covariance=alignment.covariance,
        hand_eye_drift=drift,
        hand_eye_error=estimate_hand_eye_error(alignment, sigmas),
    )


def transform_cloud(cloud: NormalCloud, T: NDArray[np.float64]) -> NormalCloud:
    """Apply the motion `T` (4, 4), base to base, to the points, normals and poses of a cloud."""
    T_base_camera = cloud.T_base_camera
    if T_base_camera is not None:
        T_base_camera = T @ T_base_camera
    return replace(
        cloud,
        points=transform_points(T, cloud.points),
        normals=cloud.normals @ T[:3, :3].T,
        T_correction=T @ cloud.T_correction,
        T_base_camera=T_base_camera,
    )


def _sort_views(
    clouds: Sequence[NormalCloud], correspondences: Sequence[Correspondences] | None, parameters: ChainParameters
) -> ComparedViews:
    """Return the views in the order of their indices. The correspondences are searched if they are None."""
    order = np.argsort([cloud.view for cloud in clouds])
    # Which views are compared depends on their order of arrival.
    is_compared = compared_views(clouds)[np.ix_(order, order)]
    clouds = [clouds[k] for k in order]
    if correspondences is None:
        correspondences = _find_all_correspondences(clouds, is_compared, parameters)
    return ComparedViews(clouds, is_compared, correspondences)


def _find_all_correspondences(
    clouds: Sequence[NormalCloud], is_compared: NDArray[np.bool_], parameters: ChainParameters
) -> list[Correspondences]:
    """Return the correspondences of each view with the earlier views that it is compared with."""
    found: list[Correspondences] = []
    for k, cloud in enumerate(clouds):
        others = [clouds[j] for j in np.flatnonzero(is_compared[k, :k]).tolist()]
        found += find_correspondences(cloud, others, parameters)
    return found


def _align(
    views: ComparedViews, centre: NDArray[np.float64], parameters: ChainParameters, sigmas: PoseSigmas
) -> tuple[Alignment, list[NormalCloud]]:
    """Return the alignment of the views, and the clouds at their aligned poses."""
    prior = pose_prior(views.clouds, centre, sigmas)
    alignment = align_views(views, centre, prior, parameters)
    corrections = correction_transforms(alignment.twists, centre)
    return alignment, [transform_cloud(cloud, T) for cloud, T in zip(views.clouds, corrections, strict=True)]


def _loosen_sigmas(sigmas: PoseSigmas, robot_errors: NDArray[np.float64]) -> PoseSigmas | None:
    """Return larger sigmas if the robot errors (V,) of the views exceed the assumed errors, else None.

    All sigmas grow by the same factor, which reduces the weight of the prior relative to the surfaces.
    """
    ratio = float(np.sqrt(np.mean(robot_errors**2))) / EXPECTED_ROBOT_RMS
    if ratio <= MAX_ROBOT_RMS_RATIO:
        return None
    return replace(sigmas, **{name: ratio * value for name, value in asdict(sigmas).items()})


def _excluded_qualities(clouds: Sequence[NormalCloud], reasons: Mapping[int, ExclusionReason]) -> list[ViewQuality]:
    """Return the quality of each excluded view, with its reason."""
    return [
        ViewQuality(cloud.view, False, reasons[cloud.view].message, len(cloud.points), code=reasons[cloud.view].code)
        for cloud in clouds
        if cloud.view in reasons
    ]


def _find_drift(hand_eye_error: NDArray[np.float64], sigmas: PoseSigmas) -> Finding | None:
    """Return a finding if the hand-eye error (6,) is larger than a good calibration allows."""
    angle_rad = np.linalg.norm(hand_eye_error[:3])
    distance_m = np.linalg.norm(hand_eye_error[3:])
    error_sigma = float(np.hypot(angle_rad / sigmas.hand_eye_rad, distance_m / sigmas.hand_eye_m))
    if error_sigma <= MAX_HAND_EYE_ERROR_SIGMA:
        return None
    message = (
        f"the calibration has drifted: the views agree best with the camera {distance_m * 1000:.1f} mm and "
        f"{np.degrees(angle_rad):.2f} degrees from its calibrated pose, {error_sigma:.0f} sigma of a good calibration; "
        "calibrate again"
    )
    return finding("calibration-drift", message, value=error_sigma, limit=MAX_HAND_EYE_ERROR_SIGMA)
