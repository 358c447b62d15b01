"""What of the cell stays as it is while the service runs, for those who draw it: workspace, table, obstacles, the arm's
shape, what is set. Metres, base frame."""

import numpy as np

from calibration.storage.hand_eye_file import HandEye
from cell.config.arm_config import ArmModelName
from cell.kinematics.collision import PARTS, collision_model
from cell.kinematics.ur_kinematics import ALPHA_RAD, ARMS
from recognition.parameters import R_MAX, R_MIN
from service.api.schemas.base import Described
from service.config.loader import ServiceConfig
from service.config.sections import GripperConfig

Matrix = list[list[float]]


class PartResource(Described):
    """A capsule of the arm: all that lies within a radius of a straight piece."""

    part: str
    frames: tuple[int, int]
    """The link frame in which each end of the piece is given: 0 the base, 6 the flange."""
    ends_m: tuple[tuple[float, float, float], tuple[float, float, float]]
    radius_m: float


class ArmShape(Described):
    """The arm with its camera, as collisions are avoided: a little thicker than it is."""

    model: ArmModelName
    d_m: list[float]
    """Denavit-Hartenberg: offset along each joint's axis ..."""
    a_m: list[float]
    """... length of each link ..."""
    alpha_rad: list[float]
    """... and its twist."""
    parts: list[PartResource]


class CameraShape(Described):
    """What viewpoints are planned with; each view of a scan has its own."""

    K: Matrix
    width: int
    height: int


class ScanUsual(Described):
    """What a live scan is, where it is not told otherwise."""

    views: int
    min_views: int
    """With fewer, a scan fails."""
    string_radius_m: float | None
    """Null: it is measured."""
    string_radius_range_m: tuple[float, float]
    """Only these are taken."""


class RoomResource(Described):
    """The cell around the strings."""

    workspace_m: list[tuple[float, float]]
    """Ranges of x, y and z."""
    table_z_m: float
    obstacles_m: list[tuple[tuple[float, float, float], tuple[float, float, float]]]
    """Lowest and highest corner of each box that the arm must not touch."""
    scan: ScanUsual
    hand_eye_max_age_days: float
    """An older hand-eye calibration is refused."""
    gripper: GripperConfig
    """That grasps are for."""
    arm: ArmShape
    camera: CameraShape


def room_resource(config: ServiceConfig, hand_eye: HandEye | None) -> RoomResource:
    """The room of a service's cell. Without a calibration, the camera is left out of the arm's shape."""
    settings = config.cell
    T_flange_camera = np.eye(4) if hand_eye is None else hand_eye.T_flange_camera
    model = collision_model(settings, T_flange_camera)
    arm, optics = ARMS[model.model], settings.camera.optics
    shapes = zip(PARTS, model.part_frames.tolist(), model.part_ends.tolist(), model.part_radii.tolist(), strict=True)
    return RoomResource.model_validate(
        {
            "workspace_m": settings.workspace_m,
            "table_z_m": settings.mounting.table_z_m,
            "obstacles_m": model.boxes[:-1].tolist(),  # the last is the workspace
            "scan": settings.scan.model_dump() | {"string_radius_range_m": (R_MIN, R_MAX)},
            "hand_eye_max_age_days": settings.hand_eye.max_age_days,
            "gripper": config.gripper,
            "arm": {
                "model": model.model,
                "d_m": arm.d_m,
                "a_m": arm.a_m,
                "alpha_rad": ALPHA_RAD,
                "parts": [
                    {"part": part, "frames": frames, "ends_m": ends, "radius_m": radius}
                    for part, frames, ends, radius in shapes
                    if hand_eye is not None or "camera" not in part
                ],
            },
            "camera": {"K": optics.K.tolist(), "width": optics.width, "height": optics.height},
        }
    )
