"""Route of the grasps of a scan: filters, and the reach of the arm for live scans and for recordings."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest

from cell.config.gripper_config import GripperSettings
from cell.kinematics.ur_kinematics import link_frames
from recognition.grasping.flange_poses import T_flange_tcp
from recognition.grasping.gripper import Gripper
from service.api.schemas.grasps import GraspsDocument
from tests.service.conftest import Serve, ServedClient
from tests.service.live_cell import LiveCell, live_cell

AssertProblem = Callable[[httpx2.Response, int, str], str]
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


def grasps_of(client: httpx2.Client, scan: dict[str, Any], **params: Any) -> dict[str, Any]:
    """Return the answer of the route, checked against its schema."""
    answer = client.get(scan["links"]["grasps"], params=params)
    assert answer.status_code == 200, answer.text
    GraspsDocument.model_validate_json(answer.content)
    return answer.json()


def test_the_grasps_are_those_of_the_model(client: ServedClient, scan: dict[str, Any]) -> None:
    model, answer = client.get(scan["links"]["model"]).json(), grasps_of(client, scan)
    assert answer["grasps"] == [grasp | {"reach": None} for grasp in model["grasps"]]
    assert (answer["total"], answer["q_home_rad"]) == (len(model["grasps"]), None)
    # the recording does not name its calibration
    assert (answer["same_calibration"], answer["same_gripper"]) == (None, True)
    np.testing.assert_allclose(answer["T_flange_tcp"], T_flange_tcp(Gripper()), atol=1e-9)
    for grasp in answer["grasps"]:
        # the tool centre point at the grasp is `reach_m` beyond the centre line
        tip = np.array(grasp["T_base_flange"]["grasp"]) @ answer["T_flange_tcp"]
        centre = np.array(grasp["T_base_grasp"])
        np.testing.assert_allclose(tip[:3, 3], centre[:3, 3] + grasp["reach_m"] * centre[:3, 2], atol=2e-6)


def test_filters_keep_ids_and_order(client: ServedClient, scan: dict[str, Any]) -> None:
    grasps = grasps_of(client, scan)["grasps"]
    for params, condition in (
        ({"chain": 0}, lambda grasp: grasp["chain"] == 0),
        ({"min_clearance_m": 0.03}, lambda grasp: grasp["clearance_m"] >= 0.03),
        ({"chain": 0, "min_s_m": 0.1}, lambda grasp: grasp["s_m"] >= 0.1),
        ({"chain": 0, "max_s_m": 0.1}, lambda grasp: grasp["s_m"] <= 0.1),
        ({"chain": 0, "min_s_m": 0.1, "max_s_m": 0.15}, lambda grasp: 0.1 <= grasp["s_m"] <= 0.15),
        ({"count": 3}, lambda grasp: grasp["id"] < 3),
        ({"count": 2, "chain": 0, "min_s_m": 0.1}, None),
    ):
        answer = grasps_of(client, scan, **params)
        expected = [grasp for grasp in grasps if condition is None or condition(grasp)]
        if condition is None:
            expected = [grasp for grasp in grasps if grasp["s_m"] >= 0.1][:2]
        assert 0 < len(expected) <= len(grasps)
        assert (answer["grasps"], answer["total"]) == (expected, len(grasps)), params


def test_conditions_that_do_not_fit_are_refused(
    client: ServedClient, scan: dict[str, Any], assert_problem: AssertProblem
) -> None:
    for params, slug, message in (
        ({"chain": 7}, "invalid-parameters", "the model has no chain 7; its chains are [0]"),
        ({"min_s_m": 0.1}, "invalid-parameters", "give `chain`, too"),
        ({"chain": 0, "min_s_m": 0.2, "max_s_m": 0.1}, "invalid-parameters", "chain 0 is not a ring"),
        ({"reachable": True, "reach": False}, "invalid-parameters", "leave one of them out"),
        ({"count": 0}, "invalid-request", "count"),
        ({"count": [3, 4]}, "invalid-request", "query.count: is given 2 times; give it once"),
        ({"chain": 0, "max_s_m": "inf"}, "invalid-request", "max_s_m"),
        ({"min_clearance_m": 0.031}, "invalid-request", "less than or equal to 0.03"),
        ({"clearance": 0.1}, "invalid-request", "there is no such parameter"),
    ):
        detail = assert_problem(client.get(scan["links"]["grasps"], params=params), 422, slug)
        assert message in detail, params


def test_grasps_beside_the_base_are_out_of_reach(client: ServedClient, scan: dict[str, Any]) -> None:
    """The recorded scene is around the origin of the base frame, where the arm stands."""
    answer = grasps_of(client, scan, reach=True, count=5)
    assert [grasp["id"] for grasp in answer["grasps"]] == [0, 1, 2, 3, 4]
    assert len(answer["q_home_rad"]) == 6
    for grasp in answer["grasps"]:
        reach = grasp["reach"]
        assert (reach["reachable"], reach["q_grasp_rad"], reach["path_free"]) == (False, None, None)
        assert reach["reason"]
        assert reach["message"]
    assert grasps_of(client, scan, reachable=True)["grasps"] == []


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    with live_cell(serve, tmp_path_factory.mktemp("live")) as live:
        yield live


@pytest.fixture(scope="module")
def live_scan(cell: LiveCell, finished: Finished) -> dict[str, Any]:
    """An ended live scan. The arm is released: the tests only read the result."""
    scan = finished(cell.client, cell.start())
    cell.release()
    return scan


@pytest.mark.slow
@pytest.mark.xdist_group("service")
def test_a_live_scan_says_which_grasps_the_arm_reaches(cell: LiveCell, live_scan: dict[str, Any]) -> None:
    answer = grasps_of(cell.client, live_scan)
    model = cell.client.get(live_scan["links"]["model"]).json()
    assert [grasp["id"] for grasp in answer["grasps"]] == list(range(len(model["grasps"])))
    reached = [grasp for grasp in answer["grasps"] if grasp["reach"]["reachable"]]
    assert len(reached) > 0.8 * len(answer["grasps"])
    for grasp in reached:
        q_rad = np.array([grasp["reach"][name] for name in ("q_pregrasp_rad", "q_grasp_rad")])
        T = link_frames(cell.settings.arm.model, q_rad)[:, -1]
        poses = [grasp["T_base_flange"][name] for name in ("pregrasp", "grasp")]
        # the poses are rounded to a micrometre
        np.testing.assert_allclose(T, poses, rtol=0, atol=2e-6)
        assert np.abs(q_rad[1] - q_rad[0]).max() < np.pi / 2  # the same branch
        turn = np.diag((-1, -1, 1, 1)) if grasp["reach"]["turned"] else np.eye(4)
        expected = np.array(model["grasps"][grasp["id"]]["T_base_flange"]["retreat"]) @ turn
        np.testing.assert_allclose(grasp["T_base_flange"]["retreat"], expected, rtol=0, atol=2e-6)
    assert {grasp["reach"]["turned"] for grasp in reached} == {True, False}
    first = grasps_of(cell.client, live_scan, reachable=True, count=3)
    assert first["grasps"] == reached[:3]
    assert first["q_home_rad"] == answer["q_home_rad"]
    others = grasps_of(cell.client, live_scan, reachable=False)
    assert len(others["grasps"]) + len(reached) == answer["total"]
    assert all(grasp["reach"] is None for grasp in grasps_of(cell.client, live_scan, reach=False)["grasps"])


@pytest.mark.slow
@pytest.mark.xdist_group("service")
def test_a_scan_recognised_again_has_the_same_reach(
    cell: LiveCell, live_scan: dict[str, Any], finished: Finished
) -> None:
    replay = finished(cell.client, cell.client.post(live_scan["links"]["reprocess"]).headers["Location"])
    live, again = (grasps_of(cell.client, scan, count=10) for scan in (live_scan, replay))
    assert again == live
    assert (again["same_calibration"], again["same_gripper"]) == (True, True)
    assert any(grasp["reach"]["reachable"] for grasp in again["grasps"])


@pytest.mark.slow
def test_grasps_for_another_gripper_have_no_reach(
    serve: Serve, tmp_path: Path, recording_file: Path, finished: Finished, assert_problem: AssertProblem
) -> None:
    """The joint angles are for a gripper of 100 mm. With a longer one, its fingertips would be far below the table."""
    with serve(tmp_path, gripper=GripperSettings(length_m=0.1)) as client:
        recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
        answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
        scan = finished(client, answer.headers["Location"])
        before = client.get(scan["links"]["grasps"])
        assert before.json()["same_gripper"]
        assert grasps_of(client, scan, reach=True)["q_home_rad"] is not None
    with serve(tmp_path, gripper=GripperSettings(length_m=0.2)) as client:
        after = client.get(scan["links"]["grasps"], headers={"If-None-Match": before.headers["ETag"]})
        assert after.json() == before.json() | {"same_gripper": False}
        for params in ({"reach": True}, {"reachable": True}):
            answer = client.get(scan["links"]["grasps"], params=params)
            detail = assert_problem(answer, 422, "invalid-parameters")
            assert "another gripper than [gripper] of the configuration has now" in detail
        again = finished(client, client.post(scan["links"]["reprocess"]).headers["Location"])
        assert grasps_of(client, again, reach=True)["T_flange_tcp"][2][3] == 0.2
