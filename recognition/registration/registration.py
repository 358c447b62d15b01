"""Bringing the views together: all at once, starting from and held by the hand-eye poses (section II.E).

In place of the paper's ICP of one cloud after the other, which slides along the string, piles up errors and makes
the first view's pose error everybody's.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import transform_points
from recognition.model.model import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import Correspondences, find_correspondences
from recognition.registration.free_space_check import find_inconsistent_views
from recognition.registration.fusion import merge_clouds
from recognition.registration.hand_eye_error import HandEyeErrorEstimate, estimate_hand_eye_error
from recognition.registration.multiview_icp import Alignment, align_views, corrections
from recognition.registration.pose_prior import PoseSigmas, pose_prior
from recognition.registration.view_fitness import evaluate_fitness

DRIFT_SIGMA = 5.0
"""Length, in sigmas of its six directions, from which on a common error of all views is a calibration's that has
drifted: chance exceeds it once in three thousand scans."""
USUAL_SPREAD = 1.6
"""Root mean square of the robot's errors in the views, in sigmas of all six directions together, as it comes out where
the sigmas are right: part of each error cannot be told from the data and stays nought."""
LOOSE_SPREAD = 1.3
"""Times the usual from which on the sigmas are too small for this robot and its calibration."""


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
    """How each view fitted and how far it was corrected; of those left out, why."""
    centre: NDArray[np.float64]
    """(3,) the point about which corrections turn."""
    covariance: NDArray[np.float64]
    """(6 V, 6 V) of the errors left in the poses of `clouds`: for each a rotation vector and a translation about
    `centre`, radians and metres."""
    warnings: tuple[str, ...] = ()
    """What the poses tell of the cell."""
    hand_eye_error: HandEyeErrorEstimate | None = None
    """What the views tell of the calibration's error; None where their surfaces tell nothing."""


def register(
    clouds: Sequence[NormalCloud],
    parameters: ChainParameters,
    pairs: Sequence[Correspondences] | None = None,
    sigmas: PoseSigmas | None = None,
) -> Registration:
    """Brings the views to where they fit one another and the told poses best, and merges them.

    `pairs` are the overlaps of each view with those before it (`find_correspondences`), where they were looked for as
    the views arrived. A view that contradicts the others is left out and the rest are registered anew.

    Raises:
        ContradictingViewsError: no majority of the views shows the same scene.
        TooCrowdedError: the views together have more points than strings have.
    """
    sigmas = sigmas or PoseSigmas()
    clouds = sorted(clouds, key=lambda cloud: cloud.view)
    if pairs is None:
        pairs = [
            overlap for k, cloud in enumerate(clouds) for overlap in find_correspondences(cloud, clouds[:k], parameters)
        ]
    centre = np.vstack([cloud.points for cloud in clouds]).mean(axis=0)
    alignment, placed = _aligned(clouds, pairs, centre, parameters, sigmas)
    reasons = find_inconsistent_views(placed, alignment.robot, parameters)
    used = clouds
    if reasons:
        used = [cloud for cloud in clouds if cloud.view not in reasons]
        pairs = [pair for pair in pairs if pair.first not in reasons and pair.second not in reasons]
        alignment, placed = _aligned(used, pairs, centre, parameters, sigmas)
    warnings = _drift(alignment.calibration, sigmas)
    spread = float(np.sqrt(np.mean(alignment.robot**2))) / USUAL_SPREAD
    if spread > LOOSE_SPREAD:
        # The views tell that the robot is worse than assumed: what is known beforehand counts less.
        looser = replace(sigmas, **{name: spread * value for name, value in asdict(sigmas).items()})
        alignment, placed = _aligned(used, pairs, centre, parameters, looser)
        sigmas = looser
    points, normals = merge_clouds(placed, parameters)
    views = evaluate_fitness(used, placed, parameters)
    views += [
        ViewQuality(cloud.view, False, reasons[cloud.view], len(cloud.points))
        for cloud in clouds
        if cloud.view in reasons
    ]
    return Registration(
        points,
        normals,
        tuple(placed),
        tuple(sorted(views, key=lambda view: view.index)),
        centre,
        alignment.covariance,
        tuple(warnings),
        estimate_hand_eye_error(alignment, sigmas),
    )


def transform_cloud(cloud: NormalCloud, T: NDArray[np.float64]) -> NormalCloud:
    """`cloud` with all that belongs to it moved by `T` (4, 4)."""
    return replace(
        cloud,
        points=transform_points(T, cloud.points),
        normals=cloud.normals @ T[:3, :3].T,
        T_correction=T @ cloud.T_correction,
        T_base_camera=None if cloud.T_base_camera is None else T @ cloud.T_base_camera,
    )


def _aligned(
    clouds: Sequence[NormalCloud],
    pairs: Sequence[Correspondences],
    centre: NDArray[np.float64],
    parameters: ChainParameters,
    sigmas: PoseSigmas,
) -> tuple[Alignment, list[NormalCloud]]:
    alignment = align_views(clouds, pairs, centre, pose_prior(clouds, centre, sigmas), parameters)
    placed = [
        transform_cloud(cloud, T)
        for cloud, T in zip(clouds, corrections(alignment.twists.ravel(), centre), strict=True)
    ]
    return alignment, placed


def _drift(calibration: NDArray[np.float64], sigmas: PoseSigmas) -> list[str]:
    """A warning when the hand-eye calibration is farther off than a calibration is."""
    turn, shift = calibration[:3], calibration[3:]
    length = float(np.hypot(np.linalg.norm(turn) / sigmas.hand_eye_rad, np.linalg.norm(shift) / sigmas.hand_eye_m))
    if length <= DRIFT_SIGMA:
        return []
    return [
        f"the calibration has drifted: the views agree best with the camera {np.linalg.norm(shift) * 1000:.1f} mm and "
        f"{np.degrees(np.linalg.norm(turn)):.2f} degrees from where the hand-eye calibration puts it, {length:.0f} "
        "sigma of a good one; calibrate anew"
    ]
