"""A new kind of camera needs one file and one entry. The whole cell works with it, in a child process."""

import time
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from calibration.storage.hand_eye_file import write_hand_eye
from calibration.target.board import Board
from cell.config.arm_config import ArmSettings, SimulatedArm, URArm
from cell.config.camera_config import CameraSettings, OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings, HandEyeSettings, ScanSettings
from cell.control.calibration_run import run_calibration
from cell.control.cell import Cell
from cell.control.equipment import ARM_KINDS, CAMERA_KINDS, CameraKind
from cell.control.progress import BoardObservation, ViewTiming
from cell.devices import CameraInfo
from cell.errors import CalibrationError, CameraUnreachableError, MissingViewsError
from cell.recording import RecordingWriter
from cell.recording.reader import read_recording
from cell.self_test.self_test import check_cell
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from tests.cell.control.file_camera import DEPTH_UNIT_M, KIND, FileCamera, FileDriver
from tests.cell.loopback import free_host

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes


class Silent:
    """A listener that ignores everything."""

    def moving(self, index: int) -> None: ...
    def recorded(self, index: int, timing: ViewTiming) -> None: ...
    def missing(self, index: int, reason: str) -> None: ...
    def detected(self, index: int, board: BoardObservation, coverage: float) -> None: ...
    def not_detected(self, index: int, reason: str) -> None: ...
    def home(self) -> None: ...


class DriverWithoutPromisedImages(FileDriver):
    """A driver that says it has images and returns none."""

    def info(self) -> CameraInfo:
        return replace(super().info(), has_images=True)


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
            cell.connect()  # the mounting of this camera is unknown
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
        assert view.intensity is None


def test_the_self_test_knows_a_third_kind_of_camera(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, KIND)
    settings = settings_with(FileCamera(folder=tmp_path), HandEyeSettings(folder=tmp_path))
    steps = {step.name: step for step in check_cell(settings)}
    assert f"depth images in {tmp_path}" in steps["configuration"].message
    assert "there are no images in" in steps["camera"].message


def test_errors_of_the_driver_reach_the_parent(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, KIND)
    cell = Cell(settings_with(FileCamera(folder=tmp_path), HandEyeSettings()))
    try:
        with pytest.raises(CameraUnreachableError, match=r"check camera\.folder"):
            cell.camera.connect()
    finally:
        cell.close()


def test_a_camera_without_images_is_not_calibrated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, KIND)
    images(tmp_path, 1)
    cell = Cell(settings_with(FileCamera(folder=tmp_path), HandEyeSettings(rough_xyz_m=(0.03, -0.06, 0.05))))
    try:
        with pytest.raises(CalibrationError, match="file camera takes no intensity images"):
            cell.prepare_calibration(Board(), time.monotonic())
        assert cell.status.state == "not_ready"  # there is no calibration to scan with
    finally:
        cell.close()


def test_a_frame_without_the_requested_image_is_a_missing_view(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    kind = CameraKind(lambda camera, _: partial(DriverWithoutPromisedImages, camera), KIND.open_timeout_s)
    monkeypatch.setitem(CAMERA_KINDS, FileCamera, kind)
    images(tmp_path, 40)
    camera, hand_eye = FileCamera(folder=tmp_path, settle_s=0.0), HandEyeSettings(rough_xyz_m=(0.03, -0.06, 0.05))
    cell = Cell(settings_with(camera, hand_eye))
    try:
        prepared = cell.prepare_calibration(Board(), time.monotonic())
        with pytest.raises(MissingViewsError, match="the camera's driver returned no intensity image"):
            run_calibration(cell, prepared, tmp_path / "calibration", Silent())
        state = cell.status.arm_state
        assert state is not None
        np.testing.assert_allclose(state.q_rad, prepared.plan.home_q_rad, atol=2e-3)
    finally:
        cell.close()
