"""Cells for the self-test: a real one that may not exist, and a simulated one that sees its table."""

import time
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector, inverse
from calibration.storage.hand_eye_file import write_hand_eye
from cell.config.arm_config import URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings, HandEyeSettings, MountingSettings
from cell.control.equipment import Equipment
from cell.devices import ArmState, Frame
from cell.planning.look_at import look_at
from cell.self_test.check_result import CheckContext
from cell.simulation.devices.frame_source import FrameSource
from cell.simulation.devices.world import simulated_world

Q_RAD = (0.3, -1.7, 1.4, -1.3, -1.5, 0.2)


def grounds_for(settings: CellSettings) -> CheckContext:
    return CheckContext(settings, Equipment(settings))


def real_cell(host: str, hand_eye: Path, **arm: object) -> CellSettings:
    return CellSettings(
        arm=URArm.model_validate({"kind": "ur", "host": host} | arm),
        camera=OakCamera(kind="oak"),
        hand_eye=HandEyeSettings(file=hand_eye),
    )


def state_at(T_base_flange: NDArray[np.float64], q_rad: tuple[float, ...] = Q_RAD) -> ArmState:
    return ArmState(
        q_rad=np.array(q_rad),
        qd_rad_s=np.zeros(6),
        T_base_flange=T_base_flange,
        robot_mode="running",
        safety_mode="normal",
        moving=False,
        controller_s=1.0,
        age_s=0.002,
    )


def written_hand_eye(folder: Path) -> Path:
    """Write a valid calibration of camera 1944 and robot 2022 that is three days old, and return its path."""
    path = folder / "hand_eye.json"
    T = from_rotation_vector((0.03, -0.06, 0.05), (0.1, 0.05, 0.4))
    write_hand_eye(path, T, created=datetime.now(UTC) - timedelta(days=3), camera_id="1944", robot_serial="2022")
    return path


EXACT = CellSettings(camera=SimulatedCamera(model="ideal", errors=0.0))


@cache
def exact_frames() -> FrameSource:
    return FrameSource(simulated_world(EXACT))


def looking_cell(told_table_z_m: float = 0.0, aside_m: float = 0.0) -> CheckContext:
    """Return the context of a simulated cell without errors, with one frame that shows the table.

    The table is at z = 0, whatever the settings give.
    """
    source = exact_frames()
    world = source.world
    middle = world.T_base_scene[:3, 3] + [aside_m, 0.0, 0.0]
    T_base_flange = look_at(middle, 0.5, 1.2, 0.45, 0.1) @ inverse(world.nominal_T_flange_camera)
    depth = source.render_depth(T_base_flange)
    settings = EXACT.model_copy(update={"mounting": MountingSettings(table_z_m=told_table_z_m)})
    context = grounds_for(settings)
    context.frame = Frame(depth, 1e-4, world.camera.K, time.time(), 1)
    context.state = state_at(T_base_flange)
    context.hand_eye = world.nominal_hand_eye
    return context
