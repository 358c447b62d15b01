"""Joint registration of all views at once, with the hand-eye poses as start and prior (section II.E).

The paper registers one cloud after the other by ICP. This method slides along the string, accumulates errors and passes
the pose error of the first view on to all others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import Correspondences, find_correspondences
from recognition.registration.free_space_check import find_inconsistent_views
from recognition.registration.fusion import merge_clouds
from recognition.registration.hand_eye_error import HandEyeErrorEstimate, estimate_hand_eye_error
from recognition.registration.multiview_icp import Alignment, align_views, correction_transforms
from recognition.registration.pose_prior import PoseSigmas, pose_prior
from recognition.registration.view_fitness import evaluate_fitness

MAX_HAND_EYE_ERROR_SIGMA = 5.0
"""Maximum Mahalanobis norm of the 6D hand-eye error. A larger error means that the calibration has drifted. It
occurs by chance once in three thousand scans."""
EXPECTED_ROBOT_RMS = 1.6
"""Expected rms over the views of the Mahalanobis norm of the 6D robot errors, if the sigmas are right. It is less than
sqrt(6) because the data do not constrain part of each error, which stays zero."""
MAX_ROBOT_RMS_RATIO = 1.3
"""Maximum ratio of the rms to `EXPECTED_ROBOT_RMS`. Above it, the sigmas are too small for this robot."""


@dataclass(frozen=True, eq=False)
class Registration:
    """The merged cloud of all views, with the corrected poses and their covariance."""

    points: NDArray[np.float64]
    """(N, 3) metres, base frame, without outliers, at most one point in each voxel."""
    normals: NDArray[np.float64]
    """(N, 3), unit length."""
    clouds: tuple[NormalCloud, ...]
    """The points of each used view as registered."""
    views: tuple[ViewQuality, ...]
    """Fitness and correction of each used view, and the reason of each excluded view, by index."""
    centre: NDArray[np.float64]
    """(3,) point about which the corrections rotate, metres, base frame."""
    covariance: NDArray[np.float64]
    """(6 V, 6 V) covariance of the remaining pose errors of `clouds`: a rotation vector and a translation about
    `centre` for each, radians and metres."""
    warnings: tuple[str, ...] = ()
    """Warnings about the calibration."""
    hand_eye_error: HandEyeErrorEstimate | None = None
    """The hand-eye error that the views show; None if their surfaces do not constrain it."""


def register(
    clouds: Sequence[NormalCloud],
    parameters: ChainParameters,
    correspondences: Sequence[Correspondences] | None = None,
    sigmas: PoseSigmas | None = None,
) -> Registration:
    """Align all views to each other and to the given poses, and merge them into one cloud.

    A view that contradicts the others is excluded, and the others are aligned again.

    Args:
        clouds: Points with normals of each view, in the base frame at its given pose.
        parameters: Parameters of the method, for the radius r.
        correspondences: Overlaps of each view with those before it, as `find_correspondences` found them when the views
            arrived. None searches them here.
        sigmas: Standard deviations of the pose errors. None takes the defaults.

    Returns:
        The merged cloud, the views as registered and their quality.

    Raises:
        ContradictingViewsError: No majority of the views shows the same scene.
        TooCrowdedError: The views together have more points than strings have.

    Source:
        Section II.E; the joint least squares, the prior and the checks are ours.
    """
    sigmas = sigmas or PoseSigmas()
    clouds = sorted(clouds, key=lambda cloud: cloud.view)
    if correspondences is None:
        correspondences = _find_all_correspondences(clouds, parameters)
    centre = np.vstack([cloud.points for cloud in clouds]).mean(axis=0)

    alignment, registered = _align(clouds, correspondences, centre, parameters, sigmas)

    reasons = find_inconsistent_views(registered, alignment.robot_errors, parameters)
    used = [cloud for cloud in clouds if cloud.view not in reasons]
    if reasons:
        correspondences = _exclude_views(correspondences, reasons)
        alignment, registered = _align(used, correspondences, centre, parameters, sigmas)
    warnings = _drift_warnings(alignment.hand_eye_error, sigmas)

    looser_sigmas = _loosen_sigmas(sigmas, alignment.robot_errors)
    if looser_sigmas is not None:
        sigmas = looser_sigmas
        alignment, registered = _align(used, correspondences, centre, parameters, sigmas)

    points, normals = merge_clouds(registered, parameters)
    qualities = evaluate_fitness(used, registered, parameters) + _excluded_qualities(clouds, reasons)
    return Registration(
        points=points,
        normals=normals,
        clouds=tuple(registered),
        views=tuple(sorted(qualities, key=lambda view: view.index)),
        centre=centre,
        covariance=alignment.covariance,
        warnings=tuple(warnings),
        hand_eye_error=estimate_hand_eye_error(alignment, sigmas),
    )


def transform_cloud(cloud: NormalCloud, T: NDArray[np.float64]) -> NormalCloud:
    """Return `cloud` with its points, normals and poses moved by `T` (4, 4), base to base."""
    return replace(
        cloud,
        points=transform_points(T, cloud.points),
        normals=cloud.normals @ T[:3, :3].T,
        T_correction=T @ cloud.T_correction,
        T_base_camera=None if cloud.T_base_camera is None else T @ cloud.T_base_camera,
    )


def _find_all_correspondences(clouds: Sequence[NormalCloud], parameters: ChainParameters) -> list[Correspondences]:
    """Return the correspondences of each view with the views before it."""
    return [
        overlap for k, cloud in enumerate(clouds) for overlap in find_correspondences(cloud, clouds[:k], parameters)
    ]


def _align(
    clouds: Sequence[NormalCloud],
    correspondences: Sequence[Correspondences],
    centre: NDArray[np.float64],
    parameters: ChainParameters,
    sigmas: PoseSigmas,
) -> tuple[Alignment, list[NormalCloud]]:
    """Return the most probable poses, and the clouds moved to them."""
    alignment = align_views(clouds, correspondences, centre, pose_prior(clouds, centre, sigmas), parameters)
    corrections = correction_transforms(alignment.twists, centre)
    return alignment, [transform_cloud(cloud, T) for cloud, T in zip(clouds, corrections, strict=True)]


def _exclude_views(correspondences: Sequence[Correspondences], reasons: Mapping[int, str]) -> list[Correspondences]:
    """Return the correspondences between views that are not excluded."""
    return [
        overlap
        for overlap in correspondences
        if overlap.source_view not in reasons and overlap.target_view not in reasons
    ]


def _loosen_sigmas(sigmas: PoseSigmas, robot_errors: NDArray[np.float64]) -> PoseSigmas | None:
    """Return larger sigmas if the views show a robot that is worse than assumed, else None.

    All sigmas grow by the same factor, so that the whole prior has less weight relative to the surfaces.
    """
    ratio = float(np.sqrt(np.mean(robot_errors**2))) / EXPECTED_ROBOT_RMS
    if ratio <= MAX_ROBOT_RMS_RATIO:
        return None
    return replace(sigmas, **{name: ratio * value for name, value in asdict(sigmas).items()})


def _excluded_qualities(clouds: Sequence[NormalCloud], reasons: Mapping[int, str]) -> list[ViewQuality]:
    """Return the quality of each excluded view, with its reason."""
    return [
        ViewQuality(index=cloud.view, used=False, reason=reasons[cloud.view], points=len(cloud.points))
        for cloud in clouds
        if cloud.view in reasons
    ]


def _drift_warnings(hand_eye_error: NDArray[np.float64], sigmas: PoseSigmas) -> list[str]:
    """Return a warning if the hand-eye error is larger than that of a good calibration."""
    rotation, translation = hand_eye_error[:3], hand_eye_error[3:]
    length = float(
        np.hypot(np.linalg.norm(rotation) / sigmas.hand_eye_rad, np.linalg.norm(translation) / sigmas.hand_eye_m)
    )
    if length <= MAX_HAND_EYE_ERROR_SIGMA:
        return []
    return [
        f"the calibration has drifted: the views agree best with the camera {np.linalg.norm(translation) * 1000:.1f} "
        f"mm and {np.degrees(np.linalg.norm(rotation)):.2f} degrees from its calibrated pose, {length:.0f} sigma of a "
        "good calibration; calibrate again"
    ]
