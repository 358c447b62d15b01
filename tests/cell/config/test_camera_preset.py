"""Camera files: reading, errors, and their use in the configuration and in the simulation."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from cell.config.camera_config import SimulatedCamera
from cell.config.camera_preset import CameraPreset, CameraPresetError, read_preset, to_text
from cell.config.cell_config import CellSettings
from cell.config.rendering_options import RenderingOptions
from cell.simulation.devices.world import simulated_world
from cell.simulation.rendering.depth_camera import camera_model, camera_of_preset

PRESET = CameraPreset(
    base="d435",
    width=320,
    height=200,
    focal_px=160.0,
    depth_unit_m=0.001,
    near_m=0.2,
    working_m=(0.3, 0.5),
    baseline_m=0.06,
    disparities=64,
    block_px=9,
    warp_px=0.2,
    row_error_px=0.1,
    bias_px=0.05,
    noise_factor=1.5,
    table_top="grained",
    sources={"baseline_m": "measured"},
    notes=("bias_px is that of d435",),
)


@pytest.fixture
def camera_file(tmp_path: Path) -> Path:
    path = tmp_path / "camera.json"
    path.write_text(to_text(PRESET))
    return path


def test_a_camera_file_is_read_as_written(camera_file: Path) -> None:
    assert read_preset(camera_file) == PRESET
    model = camera_model(str(camera_file))
    assert model == camera_of_preset(PRESET)
    assert model.stereo is not None
    assert (model.name, model.stereo.matching.block_px, model.stereo.noise_factor) == ("d435-profile", 9, 1.5)
    assert model.complete(RenderingOptions()).table_top == "grained"
    assert model.complete(RenderingOptions(table_top="bare")).table_top == "bare"


def test_a_changed_file_is_read_again(camera_file: Path) -> None:
    read_preset(camera_file)
    document = json.loads(camera_file.read_text()) | {"baseline_m": 0.0625}
    camera_file.unlink()
    camera_file.write_text(json.dumps(document) + "\n\n")
    assert read_preset(camera_file).baseline_m == 0.0625


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, 'its member "format" must be "pointchain-camera"'),
        ({"block_px": 8}, "block_px: .*must be odd"),
        ({"disparities": 50}, "disparities: .*multiple of 16"),
        ({"working_m": [0.5, 0.3]}, "working_m: .*nearest and the farthest"),
        ({"baseline_m": -1}, "baseline_m: .*greater than 0"),
        ({"baseline": 0.1}, "baseline: Extra inputs are not permitted"),
        ({"base": "ideal"}, "base: "),
    ],
)
def test_wrong_members_are_named(camera_file: Path, change: dict[str, Any], message: str) -> None:
    camera_file.write_text(json.dumps(json.loads(to_text(PRESET)) | change))
    with pytest.raises(CameraPresetError, match=message):
        read_preset(camera_file)


def test_other_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(CameraPresetError, match="cannot be read: No such file"):
        read_preset(tmp_path / "none.json")
    with pytest.raises(CameraPresetError, match="is not a file"):
        read_preset(tmp_path)
    text = tmp_path / "text.json"
    text.write_text("[camera]")
    with pytest.raises(CameraPresetError, match="not JSON"):
        read_preset(text)


def test_the_cell_has_the_camera_of_the_file(camera_file: Path) -> None:
    camera = SimulatedCamera(profile=camera_file, seed=5)
    assert camera.optics.K[0, 0] == 160.0
    assert camera.optics.working_m == (0.3, 0.5)
    assert camera.device_id == "simulated-d435-profile-5"
    assert camera.rendering_s > 0
    world = simulated_world(CellSettings(camera=camera))
    assert world.camera == camera_of_preset(PRESET)
    assert world.camera_id == camera.device_id
    assert world.provenance["table_top"] == "grained"


def test_a_file_and_another_model_contradict_each_other(camera_file: Path) -> None:
    assert SimulatedCamera(profile=camera_file, model="d435").camera_name == "d435-profile"
    with pytest.raises(ValidationError, match="profile is a camera file that is based on d435: remove model"):
        SimulatedCamera(profile=camera_file, model="oak-d-pro")
    with pytest.raises(ValidationError, match="cannot be read"):
        SimulatedCamera(profile=camera_file.with_name("none.json"))
