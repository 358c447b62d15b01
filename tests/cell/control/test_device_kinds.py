"""A further kind of camera is one file and one entry: the whole cell works with it, in a child process as always."""

import time
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from calibration.storage.hand_eye_file import write_hand_eye
from cell.config.arm_config import ArmSettings, SimulatedArm, URArm
from cell.config.camera_config import CameraSettings, OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings, HandEyeSettings, ScanSettings
from cell.control.cell import Cell
from cell.control.equipment import ARM_KINDS, CAMERA_KINDS
from cell.errors import CalibrationError, CameraUnreachableError
from cell.recording.reader import read_recording
from cell.recording.writer import RecordingWriter
from cell.self_test.self_test import check_cell
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from tests.cell.control.file_camera import DEPTH_UNIT_M, KIND, FileCamera
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes


class Silent:
    """A listener that ignores everything."""

    def moving(self, index: int) -> None: ...
    def recorded(self, index: int) -> None: ...
    def missing(self, index: int, reason: str) -> None: ...


def images(folder: Path, count: int) -> list[np.ndarray]:
    """Write depth images that differ, and return them."""
    depths = [np.full((400, 640), 900 + 10 * k, dtype=np.uint16) for k in range(count)]
    for k, depth in enumerate(depths):
        depth[:200] += 7  # an image of one depth would be a failed camera
        np.save(folder / f"{k:02d}.npy", depth)
    return depths


def settings_with(camera: CameraSettings, hand_eye: HandEyeSettings) -> CellSettings:
    arm = SimulatedArm(time_factor=20.0, watchdog_hz=1.0, host=free_host())
    settings = CellSettings(arm=arm, hand_eye=hand_eye, scan=ScanSettings(views=3, min_views=2))
    return settings.model_copy(update={"camera": camera})


def test_every_kind_of_the_settings_has_an_entry() -> None:
    assert set(CAMERA_KINDS) == {SimulatedCamera, OakCamera}
    assert set(ARM_KINDS) == {SimulatedArm, URArm}
    assert all(issubclass(kind, CameraSettings) for kind in CAMERA_KINDS)
    assert all(issubclass(kind, ArmSettings) for kind in ARM_KINDS)


def test_a_third_kind_of_camera_scans(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, KIND)
    depths, recording, file = images(tmp_path, 3), tmp_path / "scan.mcap", tmp_path / "hand_eye.json"
    camera = FileCamera(folder=tmp_path, settle_s=0.0)
    cell = Cell(settings_with(camera, HandEyeSettings(folder=tmp_path)))
    try:
        with pytest.raises(CalibrationError, match="there is no hand-eye calibration"):
            cell.connect()  # nobody knows the mounting of this camera
        write_hand_eye(file, T_FLANGE_CAMERA, created=datetime.now(UTC), camera_id="file-1")
        prepared = cell.prepare_scan(None, time.monotonic())
        assert prepared.header.provenance["camera"] == "file camera file-1"
        with RecordingWriter(recording, prepared.header) as writer, cell.run(prepared, writer, Silent()) as views:
            assert len(list(views)) == 3
        assert cell.status.state == "ready"
    finally:
        cell.close()
    recorded = read_recording(recording)
    assert recorded.header.depth_unit_m == DEPTH_UNIT_M
    for view, depth in zip(recorded.views, depths, strict=True):
        np.testing.assert_array_equal(view.depth, depth)


def test_the_self_test_knows_a_third_kind_of_camera(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, KIND)
    settings = settings_with(FileCamera(folder=tmp_path), HandEyeSettings(folder=tmp_path))
    steps = {step.name: step for step in check_cell(settings)}
    assert f"depth images in {tmp_path}" in steps["configuration"].words
    assert "there are no images in" in steps["camera"].words


def test_its_errors_cross_from_the_child(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, KIND)
    cell = Cell(settings_with(FileCamera(folder=tmp_path), HandEyeSettings()))
    try:
        with pytest.raises(CameraUnreachableError, match=r"check camera\.folder"):
            cell.camera.connect()
    finally:
        cell.close()
