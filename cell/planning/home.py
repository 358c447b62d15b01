"""Home posture, in which the arm waits between scans: above the workspace, elbow up, camera downwards."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.config.camera_optics import CameraOptics
from cell.config.cell_config import CellSettings
from cell.errors import ViewpointsError
from cell.kinematics.collision import CollisionModel, collision_model
from cell.kinematics.ik_branches import find_ik_solutions
from cell.kinematics.ur_kinematics import jacobian, link_frames
from cell.planning.candidate_poses import ViewTarget
from cell.planning.look_at import look_at

_FARTHER_M = (0.0, 0.06, -0.06, 0.12, -0.12)
"""Distances beyond the largest working distance, tried in this order."""
_ELEVATIONS_RAD = np.deg2rad((80.0, 65.0, 50.0))
_ASIDE_RAD = np.deg2rad((0.0, 40.0, -40.0, 90.0, -90.0, 180.0))
_ROLLS_RAD = np.deg2rad(np.arange(-180.0, 180.0, 30.0))


def home_posture(settings: CellSettings, T_flange_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the joint angles (6,) of the home posture: the configured ones, else the best that are found.

    Raises:
        ViewpointsError: The configured posture is not free, or no free posture is found.
    """
    collisions = collision_model(settings, T_flange_camera)
    return planned_home(settings, collisions, ViewTarget.of(settings, settings.camera.optics, T_flange_camera))


def planned_home(settings: CellSettings, collisions: CollisionModel, view_target: ViewTarget) -> NDArray[np.float64]:
    """Return the same as `home_posture`, for the collision model and the view target of the cell."""
    if settings.arm.home_q_rad is None:
        return find_home(collisions, view_target.centre, view_target.optics, view_target.T_flange_camera)
    home = np.array(settings.arm.home_q_rad)
    short = collisions.gaps(home[None])[0] - collisions.clearances
    if short.min() < 0:
        raise ViewpointsError(
            f"home_q_rad in [arm] is not free: {collisions.contacts[short.argmin()]}, by {-short.min():.3f} m; give "
            "another one, or remove it"
        )
    return home


def find_home(
    collisions: CollisionModel, target: NDArray[np.float64], optics: CameraOptics, T_flange_camera: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the joint angles (6,) of a home posture above the workspace.

    Args:
        collisions: Collision model of the cell.
        target: Middle of the workspace's floor (3,), base frame.
        optics: Optics of the camera.
        T_flange_camera: Camera pose on the flange (4, 4).

    Raises:
        ViewpointsError: No posture above the workspace is free.
    """
    to_base = float(np.arctan2(-target[1], -target[0]))
    T_camera_flange = inverse(T_flange_camera)
    best: NDArray[np.float64] | None = None
    for farther in _FARTHER_M:
        for elevation in _ELEVATIONS_RAD:
            for aside in _ASIDE_RAD:
                poses = [
                    look_at(target, to_base + aside, elevation, optics.working_m[1] + farther, roll) @ T_camera_flange
                    for roll in _ROLLS_RAD
                ]
                q = find_ik_solutions(collisions, np.array(poses)).q_rad
                if not len(q):
                    continue
                # the posture farthest from a singularity, from which all viewpoints are near
                agility = np.linalg.svd(jacobian(collisions.model, q), compute_uv=False)[:, -1]
                q = q[(-agility).argsort(kind="stable")]
                upright = q[_elbow_up(collisions, q)]
                if len(upright):
                    return upright[0]
                best = q[0] if best is None else best
    if best is None:
        raise ViewpointsError(
            "no home posture was found above the workspace: check [workspace], table_z_m and obstacles_m, or give "
            "home_q_rad in [arm]"
        )
    return best


def _elbow_up(collisions: CollisionModel, q: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for each posture whether the elbow is above the line from the shoulder to the wrist."""
    shoulder, elbow, wrist = link_frames(collisions.model, q)[:, 1:4, :3, 3].swapaxes(0, 1)
    line, upper_arm = wrist - shoulder, elbow - shoulder
    share = (upper_arm * line).sum(axis=1) / (line * line).sum(axis=1)
    return upper_arm[:, 2] > share * line[:, 2]
