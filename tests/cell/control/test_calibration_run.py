"""Calibration of a whole simulated cell with a known mounting: virtual controller, simulated camera and board."""

import json
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.dataset.folder import HAND_EYE_FILE, read_folder
from calibration.dataset.setup import Setup
from calibration.dataset.view_detection import detect_views
from calibration.errors import CalibrationFolderError
from calibration.geometry.transforms import from_rotation_vector, inverse, rotation_angle
from calibration.hand_eye import solve_hand_eye
from calibration.storage.hand_eye_file import activate, load_hand_eye, write_hand_eye
from calibration.target.board import Board
from calibration.verification.verification import Verification
from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings, HandEyeSettings
from cell.control.calibration_run import CalibrationRun, run_calibration, run_verification
from cell.control.cell import Cell
from cell.control.prepared import PreparedCalibration
from cell.control.progress import BoardObservation, ViewTiming
from cell.devices import View
from cell.errors import CalibrationError, MissingViewsError, StoppedError, ViewpointsError
from cell.simulation.devices.world import simulated_world
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from cell.simulation.ur_controller.admin_client import AdminClient

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

BOARD = Board()


class RecordingListener:
    """Listener that records all calls."""

    def __init__(self, on_recorded: Callable[[int], None] | None = None) -> None:
        self.events: list[tuple[str, int]] = []
        self.reasons: dict[int, str] = {}
        self.coverage: list[float] = []
        self.boards: dict[int, BoardObservation] = {}
        self._on_recorded = on_recorded

    def moving(self, index: int) -> None:
        self.events.append(("moving", index))

    def recorded(self, index: int, timing: ViewTiming) -> None:
        self.events.append(("recorded", index))
        if self._on_recorded is not None:
            self._on_recorded(index)

    def missing(self, index: int, reason: str) -> None:
        self.reasons[index] = reason

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        self.boards[index] = board
        self.coverage.append(coverage)

    def not_detected(self, index: int, reason: str) -> None:
        self.reasons[index] = reason

    def home(self) -> None:
        self.events.append(("home", -1))


def settings_with(folder: Path, **hand_eye: Any) -> CellSettings:
    """Return the settings of a fast simulated cell."""
    return CellSettings(
        arm=SimulatedArm(time_factor=20.0, watchdog_hz=1.0),
        camera=SimulatedCamera(model="ideal", fps=30.0, settle_s=0.0, exposures=2),
        hand_eye=HandEyeSettings(folder=folder, **hand_eye),
    )


def error_of(X: NDArray[np.float64], settings: CellSettings) -> tuple[float, float]:
    """Return the error of X in metres and radians."""
    off = inverse(simulated_world(settings).T_flange_camera) @ X
    return float(np.linalg.norm(off[:3, 3])), rotation_angle(off)


def controller_q(cell: Cell) -> NDArray[np.float64]:
    assert cell.controller_host is not None
    with closing(AdminClient(cell.controller_host)) as admin:
        return admin.state().q_rad


def prepared_calibration(cell: Cell, board: Board = BOARD, **numbers: int) -> PreparedCalibration:
    return cell.prepare_calibration(board, time.monotonic(), **numbers)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("calibration")


@pytest.fixture(scope="module")
def cell(folder: Path) -> Iterator[Cell]:
    """Yield a cell that all tests share. Each test leaves it ready."""
    cell = Cell(settings_with(folder))
    yield cell
    cell.close()


@pytest.fixture(scope="module")
def done(cell: Cell, folder: Path) -> tuple[CalibrationRun, RecordingListener, Path]:
    """Return a calibration of that cell, its listener, and its folder."""
    reasons: set[str | None] = set()
    listener, run_folder = RecordingListener(lambda _: reasons.add(cell.status.reason)), folder / "runs" / "1"
    prepared = prepared_calibration(cell)
    run, plan = run_calibration(cell, prepared, run_folder, listener), prepared.plan
    np.testing.assert_allclose(controller_q(cell), plan.home_q_rad, atol=2e-3)
    assert cell.status.state == "ready"
    assert reasons == {"a calibration is under way"}
    order = [leg.view for leg in plan.legs if leg.view is not None]
    moves = [event for index in order for event in (("moving", index), ("recorded", index))]
    assert listener.events == [*moves, ("home", -1)]
    return run, listener, run_folder


def test_a_calibration_finds_the_true_mounting(
    cell: Cell, done: tuple[CalibrationRun, RecordingListener, Path]
) -> None:
    run, listener, _ = done
    assert run.result.verdict == "accept"
    off_m, off_rad = error_of(run.result.X, cell.settings)
    # The required bounds. The simulated arm errs by 0.5 mm and 0.1 degrees.
    assert off_m < 0.0004
    assert off_rad < np.deg2rad(0.08)
    assert off_m < 3 * run.result.sigma_m
    assert run.unused == ()
    assert listener.reasons == {}
    assert {(board.corners, board.board_corners) for board in listener.boards.values()} == {(48, 48)}
    assert listener.coverage == sorted(listener.coverage)
    # Each view is evaluated alone, with the nominal camera matrix.
    assert all(board.rms_px is not None and 0 < board.rms_px < 0.3 for board in listener.boards.values())
    assert listener.coverage[-1] > 0.35
    assert len(run.result.views) == 15


def test_a_calibration_is_verified_on_the_held_out_poses(done: tuple[CalibrationRun, RecordingListener, Path]) -> None:
    verification = done[0].verification
    assert verification.passed
    assert verification.board_displacement_m is None
    assert len(verification.views) == 2
    assert not {view.name for view in verification.views} & {view.name for view in done[0].result.views}


def test_the_folder_gives_the_same_calibration(
    cell: Cell, done: tuple[CalibrationRun, RecordingListener, Path]
) -> None:
    run, _, folder = done
    content = read_folder(folder)
    setup: Setup = content.setup
    assert cell.status.camera is not None
    assert cell.status.arm is not None
    assert (setup.camera_id, setup.robot_serial) == (cell.status.camera.device_id, cell.status.arm.serial)
    assert setup.image_size == (640, 400)
    np.testing.assert_allclose(setup.K, simulated_world(cell.settings).camera.K)
    assert [view.name for view in content.views if view.held_out] == [view.name for view in run.verification.views]
    observed = detect_views(content)
    np.testing.assert_allclose(solve_hand_eye(observed.observations).X, run.result.X, atol=1e-9)
    document = json.loads((folder / HAND_EYE_FILE).read_text())
    assert (document["verdict"], document["verification"]["passed"]) == ("accept", True)
    # All dates are those of the images.
    assert setup.created is not None
    assert setup.created == observed.observations.created
    assert document["created"] == setup.created.isoformat()


def test_a_calibration_is_never_overwritten(cell: Cell, done: tuple[CalibrationRun, RecordingListener, Path]) -> None:
    before = controller_q(cell)
    with pytest.raises(CalibrationFolderError, match="already has a calibration"):
        run_calibration(cell, prepared_calibration(cell), done[2], RecordingListener())
    np.testing.assert_array_equal(controller_q(cell), before)


def verification_of(cell: Cell, folder: Path) -> Verification:
    """Verify the active calibration of the cell."""
    reasons: set[str | None] = set()
    listener = RecordingListener(lambda _: reasons.add(cell.status.reason))
    verification = run_verification(cell, cell.prepare_verification(time.monotonic()), folder, listener)
    assert reasons == {"a verification is under way"}
    return verification


def test_a_verification_passes_and_detects_a_drift(
    cell: Cell, folder: Path, done: tuple[CalibrationRun, RecordingListener, Path], tmp_path: Path
) -> None:
    with pytest.raises(CalibrationError, match="no hand-eye calibration to verify yet: calibrate the cell with"):
        cell.prepare_verification(time.monotonic())
    active = folder / HAND_EYE_FILE
    activate(done[2] / HAND_EYE_FILE, active)
    try:
        good = verification_of(cell, tmp_path / "good")
        assert good.passed, good.message
        assert len(good.views) == 2
        # The camera has not moved, but the file has an error of 5 mm.
        document = json.loads(active.read_text())
        document["T_flange_camera"]["xyz_m"][0] += 0.005
        active.write_text(json.dumps(document))
        bad = verification_of(cell, tmp_path / "bad")
        assert not bad.passed
        assert "calibrate again" in bad.message
        # A scan uses the strings again, and the calibration of that file.
        cell.prepare_scan(2, time.monotonic())
        assert cell.status.hand_eye is not None
        assert cell.status.hand_eye.T_flange_camera[0, 3] == document["T_flange_camera"]["xyz_m"][0]
    finally:
        active.unlink()


def test_a_verification_is_refused_if_the_calibration_has_changed(
    cell: Cell, folder: Path, done: tuple[CalibrationRun, RecordingListener, Path], tmp_path: Path
) -> None:
    active = folder / HAND_EYE_FILE
    activate(done[2] / HAND_EYE_FILE, active)
    try:
        prepared, before = cell.prepare_verification(time.monotonic()), controller_q(cell)
        assert prepared.hand_eye.sha256 == load_hand_eye(active, np.inf).sha256
        document = json.loads(active.read_text())
        document["T_flange_camera"]["xyz_m"][0] += 0.005
        active.write_text(json.dumps(document))
        with pytest.raises(CalibrationError, match="changed during its verification: verify it again"):
            run_verification(cell, prepared, tmp_path / "run", RecordingListener())
        np.testing.assert_array_equal(controller_q(cell), before)
    finally:
        active.unlink()


def test_a_failed_planning_with_an_old_calibration_leaves_the_cell_not_ready(
    cell: Cell, folder: Path, done: tuple[CalibrationRun, RecordingListener, Path]
) -> None:
    active = folder / HAND_EYE_FILE
    activate(done[2] / HAND_EYE_FILE, active)
    try:
        document = json.loads(active.read_text())
        document["created"] = "2020-01-01T00:00:00+00:00"
        document["T_flange_camera"]["xyz_m"][2] += 0.9  # no arm can hold the camera above the table
        active.write_text(json.dumps(document))
        with pytest.raises(ViewpointsError):
            cell.prepare_verification(time.monotonic())
        assert (cell.status.state, cell.status.slug) == ("not_ready", "calibration")
    finally:
        active.unlink()


def test_the_run_uses_the_mounting_of_its_plan(cell: Cell, folder: Path, tmp_path: Path) -> None:
    prepared = prepared_calibration(cell, poses=10, held_out=0)
    planned_with, active = prepared.hand_eye.T_flange_camera, folder / HAND_EYE_FILE
    try:
        write_hand_eye(active, planned_with @ from_rotation_vector((0.1, 0, 0), (0, 0, 0)), created=datetime.now(UTC))
        views: list[View] = []

        class Stopping:
            def write_view(self, view: View) -> View:
                views.append(view)
                cell.stop()
                return view

        with pytest.raises(StoppedError), cell.run(prepared, Stopping(), RecordingListener()) as views_of_run:
            list(views_of_run)
        np.testing.assert_array_equal(views[0].T_flange_camera, planned_with)
    finally:
        active.unlink()


def test_an_unwritable_folder_is_reported_before_the_arm_moves(cell: Cell, tmp_path: Path) -> None:
    prepared, before = prepared_calibration(cell, poses=10, held_out=0), controller_q(cell)
    (tmp_path / "file").write_text("")
    listener = RecordingListener()
    with pytest.raises(OSError, match="Not a directory"):
        run_calibration(cell, prepared, tmp_path / "file" / "run", listener)
    assert listener.events == []
    np.testing.assert_array_equal(controller_q(cell), before)
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The system writes nothing beyond this size, as on a full disk.
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, limit[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            run_calibration(cell, prepared, tmp_path / "run", listener)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert listener.events == []
    assert list((tmp_path / "run").iterdir()) == []
    np.testing.assert_array_equal(controller_q(cell), before)


def test_a_cell_with_an_unusable_calibration_is_not_ready_after_the_run(
    cell: Cell, folder: Path, tmp_path: Path
) -> None:
    active = folder / HAND_EYE_FILE
    write_hand_eye(active, T_FLANGE_CAMERA, created=datetime.now(UTC), camera_id="another")
    try:
        prepared = prepared_calibration(cell, poses=10, held_out=0)
        with pytest.raises(MissingViewsError):
            run_calibration(
                cell, replace(prepared, board=Board(dictionary="DICT_5X5_100")), tmp_path / "run", RecordingListener()
            )
        assert (cell.status.state, cell.status.slug) == ("not_ready", "calibration")
        assert "made with camera another" in str(cell.status.reason)
    finally:
        active.unlink()
    cell.connect()
    assert cell.status.state == "ready"


def test_failed_captures_are_named_and_the_other_views_are_solved(cell: Cell, tmp_path: Path) -> None:
    def fail(index: int) -> None:
        cell.camera.fault("constant" if len(listener.events) == 6 else "none")  # three views are recorded

    listener = RecordingListener(on_recorded=fail)
    prepared = prepared_calibration(cell, poses=9, held_out=0)
    # From then on, captures fail until the fault is cleared.
    missing = listener.missing

    def clear_fault(index: int, reason: str) -> None:
        missing(index, reason)
        cell.camera.fault("none")

    listener.missing = clear_fault
    run = run_calibration(cell, prepared, tmp_path / "run", listener)
    assert len(listener.reasons) == 1
    assert len(run.result.views) == 8
    assert len(run.unused) == 1
    assert "not-verified" in {finding.code for finding in run.result.findings}
    assert not run.verification.passed


def test_the_views_before_a_stop_are_on_the_disk(cell: Cell, tmp_path: Path) -> None:
    def stop(index: int) -> None:
        if len(listener.events) == 6:
            cell.stop()

    listener = RecordingListener(on_recorded=stop)
    with pytest.raises(StoppedError):
        run_calibration(cell, prepared_calibration(cell), tmp_path / "run", listener)
    assert cell.status.slug == "stopped"
    observed = detect_views(read_folder(tmp_path / "run"))
    assert len(observed.observations.views) + len(observed.held_out.views) == 3
    cell.connect()
    assert cell.status.state == "ready"


def test_a_missing_board_is_reported(cell: Cell, tmp_path: Path) -> None:
    listener = RecordingListener()
    another = Board(dictionary="DICT_5X5_100")
    prepared = prepared_calibration(cell, poses=8, held_out=0)
    with pytest.raises(MissingViewsError, match="seen in 0 views, 8 are needed: lay it flat in the middle"):
        run_calibration(cell, replace(prepared, board=another), tmp_path / "run", listener)
    assert set(listener.reasons) == set(range(8))
    assert cell.status.state == "ready"


def test_without_an_initial_guess_the_error_asks_for_a_measurement(tmp_path: Path) -> None:
    settings = CellSettings(
        arm=URArm(kind="ur", host="127.255.255.1"),
        camera=OakCamera(kind="oak"),
        hand_eye=HandEyeSettings(folder=tmp_path),
    )
    with closing(Cell(settings)) as cell:
        with pytest.raises(CalibrationError, match=r"measure with a ruler .* hand_eye\.rough_xyz_m"):
            prepared_calibration(cell)
        with pytest.raises(CalibrationError, match=r"there is no hand-eye calibration .* yet: calibrate the"):
            cell.connect()


@pytest.mark.soak
def test_a_measured_mounting_suffices(tmp_path: Path) -> None:
    true = simulated_world(settings_with(tmp_path)).T_flange_camera
    rough = true @ from_rotation_vector((0.02, -0.02, 0.01), np.deg2rad((4.0, -5.0, 7.0)))
    turn = np.array([rough[2, 1] - rough[1, 2], rough[0, 2] - rough[2, 0], rough[1, 0] - rough[0, 1]])
    angle = rotation_angle(rough)
    settings = settings_with(
        tmp_path,
        rough_xyz_m=tuple(rough[:3, 3]),
        rough_rotation_rad=tuple(turn / (2 * np.sin(angle)) * angle),
    )
    with closing(Cell(settings)) as cell:
        run = run_calibration(cell, prepared_calibration(cell), tmp_path / "run", RecordingListener())
    assert run.result.verdict == "accept"
    off_m, off_rad = error_of(run.result.X, settings)
    # Three standard deviations for this arm, as measured over many cells.
    assert off_m < 0.0012
    assert off_rad < np.deg2rad(0.1)


@pytest.mark.soak
def test_a_symmetric_board_is_calibrated(tmp_path: Path) -> None:
    with closing(Cell(settings_with(tmp_path))) as cell:
        board = Board(kind="checkerboard", columns=9, rows=7, pitch_m=0.026)
        run = run_calibration(cell, prepared_calibration(cell, board), tmp_path / "runs" / "1", RecordingListener())
        assert run.result.verdict == "accept"
        assert [view.used for view in run.result.views] == [True] * 15
        assert run.verification.passed
        activate(tmp_path / "runs" / "1" / HAND_EYE_FILE, tmp_path / "hand_eye.json")
        verification = run_verification(
            cell, cell.prepare_verification(time.monotonic()), tmp_path / "runs" / "2", RecordingListener()
        )
        assert verification.passed
        assert verification.board_displacement_m is None
