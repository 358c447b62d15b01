"""The whole simulated cell without a service: real ur_rtde and depthai, virtual controller, simulated camera."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings, HandEyeSettings
from cell.control.cell import Cell
from cell.control.prepared import PreparedScan
from cell.control.progress import BoardObservation
from cell.devices import View
from cell.errors import (
    AcknowledgeRequiredError,
    CameraUnreachableError,
    MissingViewsError,
    RobotNotReadyError,
    RobotUnreachableError,
    StoppedError,
)
from cell.recording import RecordingWriter, read_recording
from cell.simulation.devices.world import simulated_world, world_truth
from cell.simulation.evaluation.metrics import score
from cell.simulation.ur_controller.admin_client import AdminClient
from cell.simulation.ur_controller.launcher import ControllerStartError, RunningController, start_controller
from recognition.parameters import ChainParameters
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from tests.cell.loopback import free_host
from tests.processes import children

pytestmark = pytest.mark.xdist_group("cell")  # one at a time, because each test runs several busy processes

RADIUS_M = 0.0042


class Told:
    """A listener that keeps what it was told."""

    def __init__(
        self, on_recorded: Callable[[int], None] | None = None, on_missing: Callable[[int], None] | None = None
    ) -> None:
        self.events: list[tuple[str, int]] = []
        self.reasons: dict[int, str] = {}
        self._on_recorded, self._on_missing = on_recorded, on_missing

    def moving(self, index: int) -> None:
        self.events.append(("moving", index))

    def recorded(self, index: int) -> None:
        self.events.append(("recorded", index))
        if self._on_recorded is not None:
            self._on_recorded(index)

    def missing(self, index: int, reason: str) -> None:
        self.events.append(("missing", index))
        self.reasons[index] = reason
        if self._on_missing is not None:
            self._on_missing(index)

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None: ...
    def not_detected(self, index: int, reason: str) -> None: ...
    def home(self) -> None: ...


def simulated(time_factor: float = 20.0, **camera: Any) -> CellSettings:
    quick: dict[str, Any] = {"model": "ideal", "fps": 30.0, "exposures": 1, "settle_s": 0.0}
    return CellSettings(
        arm=SimulatedArm(time_factor=time_factor, watchdog_hz=1.0), camera=SimulatedCamera(**quick | camera)
    )


@contextmanager
def opened(settings: CellSettings) -> Iterator[Cell]:
    cell = Cell(settings)
    try:
        yield cell
    finally:
        cell.close()


def prepared_scan(cell: Cell, views: int | None = None) -> PreparedScan:
    return cell.prepare_scan(views, time.monotonic())


def scan(cell: Cell, path: Path, listener: Told, prepared: PreparedScan | None = None) -> list[View]:
    prepared = prepared or prepared_scan(cell)
    with RecordingWriter(path, prepared.header) as writer, cell.run(prepared, writer, listener) as views:
        return list(views)


def connected(cell: Cell) -> Cell:
    cell.connect()
    return cell


def wait_for_fault(cell: Cell) -> None:
    deadline = time.monotonic() + 30
    while cell.status.state != "fault":
        assert time.monotonic() < deadline, "nobody noticed"
        time.sleep(0.02)


def controller(cell: Cell) -> AdminClient:
    assert cell.controller_host is not None
    return AdminClient(cell.controller_host)


@pytest.fixture(scope="module")
def cell() -> Iterator[Cell]:
    """One that many tests share; each leaves it able to scan."""
    with opened(simulated()) as shared:
        yield shared


def test_each_view_is_announced_taken_and_on_the_disk_in_the_planned_order(cell: Cell, tmp_path: Path) -> None:
    told, path = Told(), tmp_path / "scan.mcap"
    prepared = prepared_scan(cell)
    views = scan(cell, path, told, prepared)
    order = [leg.view for leg in prepared.plan.legs if leg.view is not None]
    assert [view.index for view in views] == order
    assert told.events == [event for index in order for event in (("moving", index), ("recorded", index))]
    recorded = read_recording(path)
    assert [view.index for view in recorded.views] == order
    for taken, read in zip(views, recorded.views, strict=True):
        np.testing.assert_array_equal(taken.T_base_flange, read.T_base_flange)
        # The pose is the controller's own; the plan's is by nominal kinematics, which the virtual arm has.
        wanted = prepared.plan.viewpoints[taken.index].T_base_flange
        np.testing.assert_allclose(taken.T_base_flange, wanted, atol=5e-4)
    # The arm is home and the cell ready for the next.
    np.testing.assert_allclose(controller_q(cell), prepared.plan.home_q_rad, atol=2e-3)
    assert cell.status.state == "ready"


def controller_q(cell: Cell) -> np.ndarray:
    admin = controller(cell)
    q_rad = admin.state().q_rad
    admin.close()
    return q_rad


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(2, 20))])
def test_a_scan_of_a_random_scene_by_a_noisy_camera_gives_the_true_topology(tmp_path: Path, seed: int) -> None:
    settings = simulated(model="oak-d-pro", scene="random", seed=seed, exposures=5)
    with opened(settings) as cell:
        views = scan(cell, tmp_path / "scan.mcap", Told())
    scene = Scene(settings.mounting.table_z_m, settings.workspace_m)
    model = recognise(views, ChainParameters.for_radius(RADIUS_M), scene).model
    judged = score(model.to_json(), world_truth(simulated_world(settings)))
    assert judged.topology
    # Told poses are .5 mm and the calibration .7 mm off.
    assert judged.mean_m is not None
    assert judged.mean_m < 0.001


def test_a_scan_by_devices_with_the_errors_of_real_ones_gives_the_true_topology(tmp_path: Path) -> None:
    plain = simulated(model="oak-d-pro-measured", exposures=5)
    arm = plain.arm.model_copy(update={"pose_error_m": 0.0006, "pose_error_rad": 0.0026, "pose_error_seed": 4})
    settings = plain.model_copy(update={"arm": arm})
    with opened(settings) as cell:
        prepared = prepared_scan(cell)
        views = scan(cell, tmp_path / "scan.mcap", Told(), prepared)
    offsets_m = [
        np.linalg.norm((view.T_base_flange - prepared.plan.viewpoints[view.index].T_base_flange)[:3, 3])
        for view in views
    ]
    assert 0.0002 < np.sqrt(np.mean(np.square(offsets_m))) < 0.0018  # three times the error that was set, at most
    scene = Scene(settings.mounting.table_z_m, settings.workspace_m)
    model = recognise(views, ChainParameters.for_radius(RADIUS_M), scene).model
    assert score(model.to_json(), world_truth(simulated_world(settings))).topology


def test_a_camera_that_dies_is_started_again_and_costs_no_view(cell: Cell, tmp_path: Path) -> None:
    def kill(index: int) -> None:
        if len(told.events) == 6:
            assert cell.camera.pid is not None
            os.kill(cell.camera.pid, signal.SIGKILL)

    told = Told(kill)
    assert len(scan(cell, tmp_path / "scan.mcap", told)) == 8
    assert told.reasons == {}


def test_a_view_that_the_camera_fails_is_missing_and_the_other_seven_are_kept(cell: Cell, tmp_path: Path) -> None:
    def fail(index: int) -> None:
        if len(told.events) == 4:  # two views are taken
            cell.camera.fault("zero")

    told = Told(on_recorded=fail, on_missing=lambda index: cell.camera.fault("none"))
    views = scan(cell, tmp_path / "scan.mcap", told)
    (missing,) = told.reasons
    assert {view.index for view in views} == set(range(8)) - {missing}
    assert [view.index for view in read_recording(tmp_path / "scan.mcap").views] == [view.index for view in views]
    assert cell.status.state == "ready"


def test_the_views_can_be_asked_for_again_after_the_last(cell: Cell, tmp_path: Path) -> None:
    prepared = prepared_scan(cell, 2)
    with (
        RecordingWriter(tmp_path / "scan.mcap", prepared.header) as writer,
        cell.run(prepared, writer, Told()) as views,
    ):
        assert len(list(views)) == 2
        assert list(views) == []


def test_an_error_behind_the_last_view_does_not_stop_an_arm_that_is_home(cell: Cell, tmp_path: Path) -> None:
    def refused(prepared: PreparedScan) -> None:
        with (
            RecordingWriter(tmp_path / "scan.mcap", prepared.header) as writer,
            cell.run(prepared, writer, Told()) as views,
        ):
            list(views)
            views.wait()
            raise ZeroDivisionError

    prepared = prepared_scan(cell, 2)
    with pytest.raises(ZeroDivisionError):
        refused(prepared)
    np.testing.assert_allclose(controller_q(cell), prepared.plan.home_q_rad, atol=2e-3)
    assert cell.status.state == "ready"


def test_a_fault_is_not_forgotten_because_somebody_plans(tmp_path: Path) -> None:
    with opened(simulated()) as cell:
        cell.connect()
        admin = controller(cell)
        admin.protective_stop()
        # The watch looks at the idle arm, and other threads plan all the time.
        deadline = time.monotonic() + 30
        while cell.status.state == "ready":
            cell.plan(2)
            assert time.monotonic() < deadline
        for _ in range(3):
            cell.plan(2)
        admin.close()
        assert (cell.status.state, cell.status.slug) == ("fault", "protective-stop")
        assert cell.status.arm_state is not None
        assert cell.status.arm_state.safety_mode == "protective_stop"


def test_a_fault_since_the_preparation_must_be_acknowledged_before_the_run(tmp_path: Path) -> None:
    with opened(simulated()) as cell, closing(controller(connected(cell))) as admin:
        prepared = prepared_scan(cell, 2)
        statuses: list[str] = []
        cell.on_status(lambda status: statuses.append(status.state))
        admin.protective_stop()
        wait_for_fault(cell)
        before = controller_q(cell)
        with pytest.raises(AcknowledgeRequiredError, match="protective stop"):
            scan(cell, tmp_path / "scan.mcap", Told(), prepared)
        assert statuses == ["fault"]  # it was never busy
        assert cell.status.slug == "protective-stop"
        np.testing.assert_array_equal(controller_q(cell), before)


def test_a_camera_that_shows_nothing_fails_the_scan_and_leaves_the_arm_home(tmp_path: Path) -> None:
    with opened(simulated()) as cell:
        prepared = prepared_scan(cell)
        cell.camera.fault("zero")
        told = Told()
        with pytest.raises(MissingViewsError, match="0 views were taken, 4 are needed"):
            scan(cell, tmp_path / "scan.mcap", told, prepared)
        assert set(told.reasons) == set(range(8))
        np.testing.assert_allclose(controller_q(cell), prepared.plan.home_q_rad, atol=2e-3)


def test_a_stop_between_planning_and_moving_keeps_the_arm_where_it_is(cell: Cell, tmp_path: Path) -> None:
    prepared = prepared_scan(cell)
    before = controller_q(cell)
    cell.stop()
    with pytest.raises(StoppedError):
        scan(cell, tmp_path / "scan.mcap", Told(), prepared)
    np.testing.assert_array_equal(controller_q(cell), before)
    assert cell.status.slug == "stopped"
    cell.connect()
    assert cell.status.state == "ready"


def test_a_stop_when_the_arm_is_home_leaves_a_cell_that_was_never_ready_behind_it(cell: Cell, tmp_path: Path) -> None:
    prepared, told = prepared_scan(cell, 2), []
    with (
        RecordingWriter(tmp_path / "scan.mcap", prepared.header) as writer,
        cell.run(prepared, writer, Told()) as views,
    ):
        assert len(list(views)) == 2
        views.wait()
        cell.on_status(lambda status: told.append((status.state, status.slug)))
        cell.stop()
    assert told == [("not_ready", "stopped")]
    cell.connect()


def test_what_was_asked_for_before_a_stop_is_refused_and_changes_nothing(cell: Cell) -> None:
    asked_s = time.monotonic()
    cell.stop()
    cell.connect()
    with pytest.raises(StoppedError, match="stopped after this request"):
        cell.prepare_scan(2, asked_s)
    assert cell.status.state == "ready"
    prepared_scan(cell, 2)


def test_a_robot_lost_on_the_way_home_is_a_fault_though_too_few_views_came_first(tmp_path: Path) -> None:
    """With too few views the arm goes home all the same; what happens on that way is the worse news."""
    with opened(simulated()) as cell:
        prepared = prepared_scan(cell)
        cell.camera.fault("zero")
        with closing(controller(cell)) as admin:

            def lost(_: int) -> None:
                if len(told.reasons) == len(prepared.plan.viewpoints):
                    admin.protective_stop(at_share=0.5)  # of the next move

            told = Told(on_missing=lost)
            with pytest.raises(MissingViewsError):
                scan(cell, tmp_path / "scan.mcap", told, prepared)
        assert (cell.status.state, cell.status.slug) == ("fault", "protective-stop")


def test_an_arm_that_was_moved_since_the_scan_was_planned_is_not_sent_that_way(tmp_path: Path) -> None:
    with opened(simulated()) as cell:
        prepared = prepared_scan(cell, 2)
        admin = controller(cell)
        # A person takes it at the pendant, turns its base, and gives it back; then somebody connects.
        admin.foreign_program()
        admin.reset(prepared.plan.start_q_rad + [1.2, 0.0, 0.0, 0.0, 0.0, 0.0])
        # The watch of an idle arm notices; to connect before that would end in the same finding, or find nothing yet.
        deadline = time.monotonic() + 20.0
        while cell.status.state == "ready":
            assert time.monotonic() < deadline, "nobody noticed"
            time.sleep(0.02)
        cell.connect()
        begin = admin.state().events
        with pytest.raises(RobotNotReadyError, match="moved after its path was planned"):
            scan(cell, tmp_path / "scan.mcap", Told(), prepared)
        assert not [event for event in admin.log(begin) if event["kind"] == "motion_start"]
        admin.close()
        assert len(scan(cell, tmp_path / "another.mcap", Told())) == 8


def test_a_scan_that_nobody_wants_any_more_stops_the_arm(tmp_path: Path) -> None:
    def interrupted(cell: Cell, prepared: PreparedScan) -> None:
        with (
            RecordingWriter(tmp_path / "scan.mcap", prepared.header) as writer,
            cell.run(prepared, writer, Told()) as views,
        ):
            next(iter(views))
            raise KeyboardInterrupt

    with opened(simulated(time_factor=2.0)) as cell:
        prepared = prepared_scan(cell)
        admin = controller(cell)
        with pytest.raises(KeyboardInterrupt):
            interrupted(cell, prepared)
        assert not admin.state().moving
        moves = [event for event in admin.log() if event["kind"] == "motion_start"]
        admin.close()
        assert len(moves) < len(prepared.plan.legs)
    assert len(read_recording(tmp_path / "scan.mcap").views) >= 1


def test_two_cells_work_side_by_side_and_one_stops_alone(tmp_path: Path) -> None:
    with opened(simulated()) as one, opened(simulated()) as other:
        prepared = [prepared_scan(each) for each in (one, other)]
        assert one.controller_host != other.controller_host
        one.stop()
        assert len(scan(other, tmp_path / "other.mcap", Told(), prepared[1])) == 8
        assert one.status.slug == "stopped"


def test_closing_leaves_no_process_behind(tmp_path: Path) -> None:
    before = children(os.getpid())
    with opened(simulated()) as cell:
        cell.connect()
        admin = controller(cell)
        assert len(children(os.getpid()) - before) == 3  # controller, arm, camera
    assert children(os.getpid()) <= before
    with pytest.raises(ConnectionError):
        admin.state()
    admin.close()


def test_without_a_robot_the_error_says_what_to_check() -> None:
    # An address of this machine at which nobody listens.
    arm = URArm(kind="ur", host="127.255.255.1")
    camera = OakCamera(kind="oak")
    with opened(CellSettings(arm=arm, camera=camera, hand_eye=HandEyeSettings(file=Path("hand_eye.json")))) as cell:
        assert cell.status.state == "not_ready"
        with pytest.raises(Exception, match=r"hand_eye\.json"):
            cell.connect()


def test_without_robot_or_camera_the_errors_name_them(tmp_path: Path) -> None:
    from datetime import UTC, datetime

    from calibration.storage.hand_eye_file import write_hand_eye

    file = tmp_path / "hand_eye.json"
    write_hand_eye(file, np.eye(4), created=datetime.now(UTC))
    settings = CellSettings(
        arm=URArm(kind="ur", host="127.255.255.1"), camera=OakCamera(kind="oak"), hand_eye=HandEyeSettings(file=file)
    )
    with opened(settings) as cell:
        told: list[str | None] = []
        cell.on_status(lambda status: told.append(status.reason))
        with pytest.raises(RobotUnreachableError, match=r"127\.255\.255\.1.*arm\.host") as refused:
            cell.connect()
        assert told == ["arm and camera are being connected: nothing moves", str(refused.value)]
    with (
        opened(settings.model_copy(update={"arm": SimulatedArm()})) as cell,
        pytest.raises(CameraUnreachableError, match="cable"),
    ):
        cell.connect()


def test_a_controller_that_is_not_ours_carries_the_simulated_camera(tmp_path: Path) -> None:
    """As UR's simulator does: all that is known of it is what any UR controller tells."""
    with start_controller(host=free_host(), time_factor=20.0) as other:
        arm = URArm(kind="ur", host=other.host, watchdog_hz=1.0)
        camera = simulated().camera.model_copy(update={"kind": "simulated"})
        with opened(CellSettings(arm=arm, camera=camera)) as cell:
            prepared = prepared_scan(cell)
            views, header = scan(cell, tmp_path / "scan.mcap", Told(), prepared), prepared.header
            world = simulated_world(cell.settings)
        model = recognise(
            views, ChainParameters.for_radius(RADIUS_M), Scene(header.table_z_m, header.workspace_m), "graph"
        ).model
    judged = score(model.to_json(), world_truth(world, [view.T_base_flange for view in views]))
    assert len(views) == 8
    assert judged.topology
    assert judged.mean_m is not None
    assert judged.mean_m < 1e-3


def test_a_controller_that_cannot_start_again_leaves_no_cell_busy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ControllerStartError("all addresses are taken")

    with opened(simulated()) as cell:
        prepared = prepared_scan(cell, 2)
        equipment = cell._equipment
        assert equipment.controller is not None
        os.kill(equipment.controller.pid, signal.SIGKILL)
        wait_for_end(equipment.controller)
        monkeypatch.setattr("cell.control.equipment.start_controller", refuse)
        with pytest.raises(RobotUnreachableError, match="all addresses are taken"):
            scan(cell, tmp_path / "scan.mcap", Told(), prepared)
        assert cell.status.state != "busy"


def wait_for_end(controller: RunningController) -> None:
    deadline = time.monotonic() + 10.0
    while controller.alive:
        assert time.monotonic() < deadline
        time.sleep(0.01)
