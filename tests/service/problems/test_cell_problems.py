"""Problems of robot and camera: each is provoked in a simulated cell, over HTTP."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest

from calibration.storage.hand_eye_file import write_hand_eye
from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.errors import CameraLostError
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from tests.cell.loopback import free_host
from tests.service.conftest import Serve, wait_until
from tests.service.live_cell import LiveCell, live_cell
from tests.service.security.conftest import without_recognition

pytestmark = pytest.mark.xdist_group("service")  # one at a time: each test runs several busy processes

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """Yield a cell that the tests share. Each test leaves it without a fault."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=20.0) as shared:
        yield shared


@pytest.mark.problem("robot-unreachable")
def test_no_robot_answers(serve: Serve, tmp_path: Path, assert_problem: AssertProblem) -> None:
    settings = {"arm": URArm(kind="ur", host=free_host()), "camera": SimulatedCamera(kind="simulated")}
    with without_recognition(serve, tmp_path, **settings) as client:
        assert_problem(client.post("/api/cell/connect"), 503, "robot-unreachable")


@pytest.mark.problem("camera-unreachable")
def test_no_camera_answers(serve: Serve, tmp_path: Path, assert_problem: AssertProblem) -> None:
    hand_eye = tmp_path / "hand_eye.json"
    write_hand_eye(hand_eye, T_FLANGE_CAMERA, created=datetime.now(UTC))
    settings = {
        "arm": SimulatedArm(host=free_host()),
        "camera": OakCamera(kind="oak"),
        "hand_eye": {"file": hand_eye},
    }
    with without_recognition(serve, tmp_path / "data", **settings) as client:
        assert_problem(client.post("/api/cell/connect"), 503, "camera-unreachable")


@pytest.mark.problem("config")
def test_a_scene_that_cannot_be_made_is_a_wrong_setting(
    serve: Serve, tmp_path: Path, assert_problem: AssertProblem
) -> None:
    settings = {
        "arm": SimulatedArm(host=free_host()),
        "camera": SimulatedCamera(kind="simulated", scene="loop", string_radius_m=0.02),
    }
    with without_recognition(serve, tmp_path, **settings) as client:
        assert_problem(client.post("/api/cell/connect"), 409, "config")


@pytest.mark.problem("emergency-stop")
def test_an_emergency_stop_cannot_be_acknowledged_while_it_is_pressed(
    cell: LiveCell, assert_problem: AssertProblem
) -> None:
    cell.is_well()
    cell.controller.emergency_stop()
    wait_until(lambda: cell.state()["state"] == "fault")
    assert_problem(cell.client.post("/api/cell/acknowledge"), 409, "emergency-stop")
    cell.controller.reset()
    assert cell.client.post("/api/cell/acknowledge").status_code == 200
    cell.is_well()


@pytest.mark.problem("motion-failed")
def test_a_move_below_the_safety_plane_fails_the_scan(cell: LiveCell, finished: Finished) -> None:
    cell.is_well()
    cell.controller.table(2.0)
    scan = finished(cell.client, cell.start())
    assert scan["state"] == "failed"
    cell.controller.table(None)
    wait_until(lambda: cell.state()["state"] == "fault")
    assert cell.client.post("/api/cell/acknowledge").status_code == 200
    cell.is_well()


@pytest.mark.problem("camera-lost")
def test_a_camera_that_is_lost_while_it_is_connected_is_reported(
    cell: LiveCell, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.is_well()

    def fail(*_: object) -> None:
        raise CameraLostError("the camera does not answer")

    # the simulated camera can always be connected again
    monkeypatch.setattr(cell.camera, "info", fail)
    monkeypatch.setattr(cell.camera, "connect", fail)
    assert_problem(cell.client.post("/api/cell/connect"), 503, "camera-lost")
    monkeypatch.undo()
    cell.is_well()
