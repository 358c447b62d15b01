"""The initial guess of the mounting for a calibration."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from calibration.storage.hand_eye_file import write_hand_eye
from cell.config.cell_config import CellSettings, HandEyeSettings
from cell.control.active_calibration import initial_guess
from cell.errors import CalibrationError
from cell.simulation.devices.world import simulated_world

BY_FILE = from_rotation_vector((0.0, -0.06, 0.04), (0.0, 0.0, 0.0))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "hand_eye.json"
    write_hand_eye(path, BY_FILE, created=datetime.now(UTC), camera_id="camera-1", robot_serial="robot-1")
    return path


def test_a_file_of_the_same_or_an_unknown_camera_and_robot_is_used(file: Path) -> None:
    guess = initial_guess(HandEyeSettings(file=file), None)
    for ids in (("camera-1", "robot-1"), (None, None), ("camera-1", None)):
        np.testing.assert_allclose(guess.choose(*ids).T_flange_camera, BY_FILE, atol=1e-12)


@pytest.mark.parametrize("ids", [("camera-2", "robot-1"), ("camera-1", "robot-2")])
def test_a_file_of_another_camera_or_robot_is_not_used(file: Path, ids: tuple[str, str]) -> None:
    with pytest.raises(
        CalibrationError,
        match=r"approximate pose of the camera on the flange \(.* made with .*-1, this is .*-2.* ruler",
    ):
        initial_guess(HandEyeSettings(file=file), None).choose(*ids)
    by_ruler = initial_guess(HandEyeSettings(file=file, rough_xyz_m=(0.2, 0.0, 0.1)), None).choose(*ids)
    np.testing.assert_allclose(by_ruler.T_flange_camera[:3, 3], (0.2, 0.0, 0.1))
    world = simulated_world(CellSettings())
    by_world = initial_guess(HandEyeSettings(file=file), world.nominal_hand_eye).choose(*ids)
    np.testing.assert_allclose(by_world.T_flange_camera, world.nominal_T_flange_camera)


@pytest.mark.parametrize(
    ("xyz_m", "rotation_rad", "apart"),
    [
        ((0.0, -0.06, 0.071), (0.0, 0.0, 0.0), "31 mm and 0 degrees"),
        ((0.0, -0.06, 0.04), (0.0, 0.0, np.deg2rad(11.0)), "0 mm and 11 degrees"),
    ],
)
def test_a_measurement_that_contradicts_the_file_is_rejected(
    file: Path, xyz_m: tuple[float, float, float], rotation_rad: tuple[float, float, float], apart: str
) -> None:
    settings = HandEyeSettings(file=file, rough_xyz_m=xyz_m, rough_rotation_rad=rotation_rad)
    with pytest.raises(CalibrationError) as refused:
        initial_guess(settings, None).choose("camera-1", "robot-1")
    words = str(refused.value)
    assert "puts the camera at [0.000, -0.060, 0.040] m" in words
    assert (
        f"rough_xyz_m at [{', '.join(f'{x:.3f}' for x in xyz_m)}] m, {apart} apart: remove the calibration file"
        in words
    )


def test_the_file_precedes_a_measurement_that_agrees_with_it(file: Path) -> None:
    turn = (0.0, np.deg2rad(9.0), 0.0)
    settings = HandEyeSettings(file=file, rough_xyz_m=(0.0, -0.06, 0.069), rough_rotation_rad=turn)
    np.testing.assert_allclose(initial_guess(settings, None).choose(None, None).T_flange_camera, BY_FILE, atol=1e-12)


def test_the_measurement_is_used_if_the_file_is_unreadable(file: Path) -> None:
    file.write_text("{")
    guess = initial_guess(HandEyeSettings(file=file, rough_xyz_m=(0.2, 0.0, 0.1)), None).choose("camera-1", "robot-1")
    assert guess.T_flange_camera[0, 3] == 0.2
    with pytest.raises(CalibrationError, match=r"approximate pose of the camera on the flange \(.*hand_eye.json"):
        initial_guess(HandEyeSettings(file=file), None)
