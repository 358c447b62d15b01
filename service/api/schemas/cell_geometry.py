"""JSON documents of what is constant in a cell while the service runs, for drawing it. Metres, base frame.

They have the workspace, the table, the obstacles, the shape of the arm, and settings.
"""

import numpy as np

from calibration.storage.hand_eye_file import HandEye
from cell.config.arm_models import ArmModelName
from cell.config.cell_config import ScanViews
from cell.config.gripper_config import GripperSettings
from cell.kinematics.collision import collision_model
from cell.kinematics.ur_kinematics import ALPHA_RAD, ARMS
from recognition.parameters import R_MAX, R_MIN
from service.api.schemas.base import ApiModel
from service.config.loader import ServiceConfig

Matrix = list[list[float]]


class ArmCapsule(ApiModel):
    """A capsule of the arm: all points within a radius of a line segment."""

    name: str
    frames: tuple[int, int]
    """Link frame of each end of the segment, from 0, the base, to 6, the flange."""
    ends_m: tuple[tuple[float, float, float], tuple[float, float, float]]
    radius_m: float


class ArmGeometry(ApiModel):
    """The arm with camera and gripper as the collision check uses it, slightly thicker than in reality."""

    model: ArmModelName
    d_m: list[float]
    """Denavit-Hartenberg offset along the axis of each joint."""
    a_m: list[float]
    """Denavit-Hartenberg length of each link."""
    alpha_rad: list[float]
    """Denavit-Hartenberg twist of each link."""
    capsules: list[ArmCapsule]


class CameraIntrinsics(ApiModel):
    """The camera model for planning viewpoints. Each view of a scan has its own."""

    K: Matrix
    width: int
    height: int


class ScanDefaults(ApiModel):
    """Defaults and limits of a live scan."""

    views: ScanViews
    """Number of viewpoints, or "auto"."""
    min_views: int
    """A scan with fewer views fails."""
    string_radius_m: float | None
    """Null means that it is measured."""
    string_radius_range_m: tuple[float, float]
    """Smallest and largest accepted radius."""


class CellGeometry(ApiModel):
    """The constant geometry of the cell, and its settings."""

    workspace_m: list[tuple[float, float]]
    """Range of x, y and z."""
    table_z_m: float
    obstacles_m: list[tuple[tuple[float, float, float], tuple[float, float, float]]]
    """Lowest and highest corner of each box that the arm must not touch."""
    scan: ScanDefaults
    hand_eye_max_age_days: float
    """An older hand-eye calibration is refused."""
    gripper: GripperSettings
    """The gripper for which grasps are computed."""
    arm: ArmGeometry
    camera: CameraIntrinsics


def cell_geometry(config: ServiceConfig, hand_eye: HandEye | None) -> CellGeometry:
    """Return the geometry of the cell. Without a calibration, the shape of the arm excludes the camera."""
    settings = config.cell
    T_flange_camera = np.eye(4) if hand_eye is None else hand_eye.T_flange_camera
    model = collision_model(settings, T_flange_camera)
    arm, optics = ARMS[model.model], settings.camera.optics
    axes, radii = zip(model.part_frames.tolist(), model.part_ends.tolist(), strict=True), model.part_radii.tolist()
    return CellGeometry.model_validate(
        {
            "workspace_m": settings.workspace_m,
            "table_z_m": settings.mounting.table_z_m,
            "obstacles_m": model.boxes[:-1].tolist(),  # without the workspace
            "scan": settings.scan.model_dump() | {"string_radius_range_m": (R_MIN, R_MAX)},
            "hand_eye_max_age_days": settings.hand_eye.max_age_days,
            "gripper": config.gripper,
            "arm": {
                "model": model.model,
                "d_m": arm.d_m,
                "a_m": arm.a_m,
                "alpha_rad": ALPHA_RAD,
                "capsules": [
                    {"name": part, "frames": frames, "ends_m": ends, "radius_m": radius}
                    for part, (frames, ends), radius in zip(model.parts, axes, radii, strict=True)
                    if hand_eye is not None or "camera" not in part
                ],
            },
            "camera": {"K": optics.K.tolist(), "width": optics.width, "height": optics.height},
        }
    )
