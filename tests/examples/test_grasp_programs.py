"""The examples that print grasps for MoveIt and for a UR controller, with a live scan of a simulated cell."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from cell.kinematics.ur_kinematics import forward
from pointchain_client import Client, GraspList, Model
from tests.service.conftest import PATIENCE_S
from tests.service.live_cell import LiveCell

pytestmark = pytest.mark.xdist_group("documents")  # one at a time: several busy processes

ROOT = Path(__file__).resolve().parents[2]
MESSAGE = {
    "id",
    "pre_grasp_posture",
    "grasp_posture",
    "grasp_pose",
    "grasp_quality",
    "pre_grasp_approach",
    "post_grasp_retreat",
    "post_place_retreat",
    "max_contact_force",
    "allowed_touch_objects",
}
"""Members of moveit_msgs/Grasp."""

Matrix = NDArray[np.float64]


@pytest.fixture(scope="module")
def planner(knot: LiveCell) -> Iterator[Client]:
    with Client(str(knot.client.base_url)) as planner:
        yield planner


@pytest.fixture(scope="module")
def scan(planner: Client) -> str:
    """A live scan of a string with one crossing. The arm is released: the tests only read the result."""
    scan = planner.scan(string_radius_m=0.0042, timeout_s=PATIENCE_S).id
    planner.release()
    return scan


@pytest.fixture(scope="module")
def model(planner: Client, scan: str) -> Model:
    return planner.model(scan)


@pytest.fixture(scope="module")
def found(planner: Client, scan: str) -> GraspList:
    found = planner.grasps(scan)
    assert found.reachable
    return found


def run(example: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, f"examples/{example}.py", *arguments],
        cwd=ROOT,
        env=os.environ,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / f"examples/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def lists(text: str) -> list[list[float]]:
    """Return the lists of six numbers in a program, in order."""
    found = re.findall(r"\[([^\]]*,[^\]]*)\]", text)
    return [[float(number) for number in numbers.split(",")] for numbers in found]


def pose_matrix(values: list[float]) -> Matrix:
    """Return the matrix (4, 4) of a pose of URScript."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(values[3:]).as_matrix(), values[:3]
    return T


def test_the_ur_program_carries_out_the_best_reachable_grasp(planner: Client, scan: str, found: GraspList) -> None:
    done = run("ur_script", str(planner._http.base_url), scan)
    number = int(re.findall(r"^# Grasp (\d+) of scan", done.stdout)[0])
    grasp = next(grasp for grasp in found.grasps if grasp.id == number)
    notes = [line for line in done.stderr.splitlines() if "takes along" not in line]
    assert (done.returncode, notes) == (0, [f"ur_script: grasp {number} has the score {grasp.score:.2f}"])
    assert number == next(each.id for each in found.reachable if each.reach and each.reach.path_free)
    assert grasp.reach is not None
    assert grasp.reach.q_pregrasp_rad is not None
    assert grasp.reach.q_grasp_rad is not None
    assert found.q_home_rad is not None
    q_home, tcp, q_pregrasp, at_grasp, retreat = lists(done.stdout)
    assert tcp == [0] * 6, "the poses are those of the flange"
    np.testing.assert_allclose(q_home, found.q_home_rad, rtol=0, atol=1e-8)
    np.testing.assert_allclose(q_pregrasp, grasp.reach.q_pregrasp_rad, rtol=0, atol=1e-8)
    # nine digits are printed
    np.testing.assert_allclose(pose_matrix(at_grasp), grasp.T_base_flange.grasp, rtol=0, atol=1e-6)
    np.testing.assert_allclose(pose_matrix(retreat), grasp.T_base_flange.retreat, rtol=0, atol=1e-6)
    # the straight line begins where movej ends, and ends at the joint angles of the reach
    np.testing.assert_allclose(forward("ur5e", np.array(q_pregrasp)), grasp.T_base_flange.pregrasp, rtol=0, atol=1e-4)
    np.testing.assert_allclose(forward("ur5e", grasp.reach.q_grasp_rad), pose_matrix(at_grasp), rtol=0, atol=1e-4)
    # the lift stays on the checked line, between pre-grasp and grasp
    ends = (grasp.T_base_flange.pregrasp[:3, 3], grasp.T_base_flange.grasp[:3, 3])
    share = np.linalg.norm(retreat[:3] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
    assert 0 < share <= 1 + 1e-6
    np.testing.assert_allclose(retreat[:3], ends[1] + share * (ends[0] - ends[1]), rtol=0, atol=1e-6)
    assert f"open_gripper({grasp.opening_m * 1000:.1f})" in done.stdout
    calls = re.findall(r"^  (set_tcp|movej|open_gripper|movel|close_gripper)\(", done.stdout, re.MULTILINE)
    assert calls == ["set_tcp", "movej", "open_gripper", "movel", "close_gripper", "movel"]
    newest = run("ur_script", str(planner._http.base_url))
    assert newest.stdout == done.stdout, "the default is the newest scan"


def test_no_program_is_printed_without_reach_or_without_a_trusted_grasp(
    planner: Client, scan: str, recording_file: Path
) -> None:
    recording = planner.get(scan).recording
    assert recording is not None
    url = str(planner._http.base_url)
    replay = planner.replay(recording_file, timeout_s=PATIENCE_S)
    for example in ("ur_script", "moveit_grasps"):
        done = run(example, url, replay.id)
        assert (done.returncode, done.stdout) == (1, "")
        assert "the reach was not determined: the scan is a recording that names no calibration" in done.stderr
    assert "--without-reach" in done.stderr
    done = run("moveit_grasps", url, replay.id, "--without-reach", "--count", "1000")
    assert (done.returncode, done.stderr) == (0, "")
    ids = [f"{replay.id}/{grasp.id}" for grasp in planner.model(replay).grasps]
    assert [message["id"] for message in json.loads(done.stdout)] == ids
    # with 6 mm as radius, the string of 4.2 mm has a doubt
    without = planner.replay(recording, string_radius_m=0.006, timeout_s=PATIENCE_S)
    for example in ("ur_script", "moveit_grasps"):
        done = run(example, url, without.id)
        assert (done.returncode, done.stdout) == (1, "")
        assert "no grasp is on a chain with the verdict accept; the verdicts are 0: review" in done.stderr


@pytest.mark.parametrize("example", ["ur_script", "moveit_grasps"])
def test_nothing_is_printed_where_the_arm_reaches_no_grasp(short_gripper: LiveCell, example: str) -> None:
    url = str(short_gripper.client.base_url)
    with Client(url) as planner:
        scan = next(planner.scans(), None) or planner.scan(string_radius_m=0.0042, timeout_s=PATIENCE_S)
        planner.release()
    for options in ((), ("--without-reach",)) if example == "moveit_grasps" else ((),):
        done = run(example, url, scan.id, *options)
        assert (done.returncode, done.stdout) == (1, "")
        assert re.search(r"the arm reaches none of \d+ grasps: .*the camera comes too near the table", done.stderr)


def test_a_grasp_without_a_safe_motion_is_not_chosen(model: Model, found: GraspList) -> None:
    choose = load("ur_script").choose
    best = choose(model, found)
    reach = best.reach
    first, rest = replace(best, reach=replace(reach, path_free=False)), found.grasps[best.id + 1 :]
    other = choose(model, replace(found, grasps=(first, *rest)))
    assert other.id > best.id
    assert choose(model, replace(found, grasps=(replace(best, object_above_m=0.03), *rest))).id == other.id
    assert "none of 1 reachable grasps has a free path" in choose(model, replace(found, grasps=(first,)))
    beyond = replace(reach, reachable=False, q_pregrasp_rad=None, q_grasp_rad=None, message="too far")
    assert choose(model, replace(found, grasps=(replace(best, reach=beyond),))).endswith("none of 1 grasps: too far")
    doubtful = replace(model, chains=(replace(model.chains[0], trust="review"),))
    assert choose(doubtful, found).endswith("with the verdict accept; the verdicts are 0: review")
    untrusted = choose(model, replace(found, grasps=(replace(best, trusted=False),)))
    assert untrusted.startswith("no grasp is on a chain with the verdict accept")


def test_the_moveit_grasps_have_the_poses_of_the_flange(planner: Client, scan: str, found: GraspList) -> None:
    options = ("--count", "5", "--joint", "knuckle", "--joint-closed", "0.8", "--joint-open", "0.0", "--touch", "table")
    done = run("moveit_grasps", str(planner._http.base_url), scan, *options)
    assert (done.returncode, done.stderr) == (0, "")
    messages = json.loads(done.stdout)
    assert [message["id"] for message in messages] == [f"{scan}/{grasp.id}" for grasp in found.reachable[:5]]
    for message, grasp in zip(messages, found.reachable, strict=False):
        motion = grasp.T_base_flange
        assert motion is not None
        assert set(message) <= MESSAGE
        T = np.eye(4)
        pose = message["grasp_pose"]["pose"]
        T[:3, :3] = Rotation.from_quat([pose["orientation"][name] for name in "xyzw"]).as_matrix()
        T[:3, 3] = vector(pose["position"])
        np.testing.assert_allclose(T, motion.grasp, rtol=0, atol=1e-6)
        approach, retreat = message["pre_grasp_approach"], message["post_grasp_retreat"]
        np.testing.assert_allclose(T[:3, 3] - shift(approach), motion.pregrasp[:3, 3], rtol=0, atol=1e-6)
        np.testing.assert_allclose(T[:3, 3] + shift(retreat), motion.retreat[:3, 3], rtol=0, atol=1e-6)
        for translation in (approach, retreat):
            assert np.linalg.norm(vector(translation["direction"]["vector"])) == pytest.approx(1)
            assert 0.9 < translation["min_distance"] / translation["desired_distance"] < 1
            assert translation["direction"]["header"] == {"frame_id": "base"}
        assert message["grasp_pose"]["header"] == {"frame_id": "base"}
        opened, closed = (message[name]["points"][0]["positions"] for name in ("pre_grasp_posture", "grasp_posture"))
        assert opened == [pytest.approx(0.8 * (1 - grasp.opening_m / 0.085))]
        assert closed == [0.8]
        assert message["grasp_posture"]["joint_names"] == ["knuckle"]
        assert (message["grasp_quality"], message["max_contact_force"]) == (grasp.score, 0.0)
        assert message["allowed_touch_objects"] == ["table"]


def test_moveit_gets_no_unreachable_grasp(model: Model, found: GraspList) -> None:
    choose = load("moveit_grasps").choose
    assert choose(model, found, without_reach=False) == (list(found.reachable), "")
    best, *others = found.reachable
    assert best.reach is not None
    beyond = replace(best, score=1.0, reach=replace(best.reach, reachable=False, message="too far"))
    mixed = replace(found, grasps=(beyond, *others))
    left_out = f"1 of {len(mixed.grasps)} grasps are left out as unreachable"
    for without_reach in (False, True):
        assert choose(model, mixed, without_reach) == (others, left_out)
        none, reason = choose(model, replace(found, grasps=(beyond,)), without_reach)
        assert (none, reason) == ([], "the arm reaches none of 1 grasps: too far")
    assert found.no_reach_reason is None
    unknown = replace(found, q_home_rad=None, grasps=tuple(replace(grasp, reach=None) for grasp in found.grasps))
    for changed, message in (
        ({"same_gripper": False}, "the gripper in the configuration has changed since; recognise the scan again"),
        ({"same_calibration": False}, "the calibration has changed since; scan again"),
    ):
        none, reason = choose(model, replace(unknown, **changed), without_reach=False)
        assert none == []
        assert reason.startswith(f"the reach was not determined: {message}")
        assert ("or give --without-reach" in reason) == ("calibration" in message)
        assert load("ur_script").choose(model, replace(unknown, **changed)).endswith(message)
    assert choose(model, unknown, without_reach=True) == (list(unknown.grasps), "")
    chosen, warning = choose(model, replace(unknown, same_calibration=False), without_reach=True)
    assert chosen == list(unknown.grasps)
    assert warning.startswith("warning: the calibration has changed since")
    # the flange poses are those of the other gripper
    assert choose(model, replace(unknown, same_gripper=False), without_reach=True)[0] == []


def test_moveit_gets_at_least_one_grasp() -> None:
    for count in ("0", "-3"):
        done = run("moveit_grasps", "http://127.0.0.1:9", "--count", count)
        assert (done.returncode, done.stdout) == (2, "")
        assert f"argument --count: it is {count}; it must be at least 1" in done.stderr


def test_the_joint_is_at_the_stroke_by_default(planner: Client, scan: str, found: GraspList) -> None:
    done = run("moveit_grasps", str(planner._http.base_url), scan, "--stroke-m", "0.05", "--count", "1")
    (message,) = json.loads(done.stdout)
    assert message["pre_grasp_posture"]["points"][0]["positions"] == [pytest.approx(found.reachable[0].opening_m)]


def test_notes_on_the_grasp_of_a_ur_program(found: GraspList) -> None:
    notes = load("ur_script").notes
    grasp = replace(found.reachable[0], id=4, chain=1, score=0.62, chains_above=())
    assert notes(grasp) == ["grasp 4 has the score 0.62"]
    low = notes(replace(grasp, score=0.31))
    assert low[0] == "grasp 4 has the score 0.31"
    assert low[1].startswith("warning: the score is below 0.5")
    lift = "the lift takes along what lies over the string"
    assert notes(replace(grasp, chains_above=(1,)))[1:] == [f"{lift}: a part of the same string"]
    assert notes(replace(grasp, chains_above=(0,)))[1:] == [f"{lift}: chain 0"]
    assert notes(replace(grasp, chains_above=(0, 1, 2)))[1:] == [f"{lift}: a part of the same string and chains 0, 2"]


@pytest.mark.parametrize("example", ["ur_script", "moveit_grasps"])
def test_the_options_are_explained(example: str) -> None:
    done = run(example, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "id of a scan" in done.stdout


@pytest.mark.parametrize("example", ["ur_script", "moveit_grasps"])
def test_a_missing_service_is_reported(example: str) -> None:
    done = run(example, "http://127.0.0.1:9")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"{example}: ")
    assert "Traceback" not in done.stderr


def vector(value: dict[str, float]) -> Matrix:
    return np.array([value[name] for name in "xyz"])


def shift(translation: dict[str, Any]) -> Matrix:
    """Return the vector of a GripperTranslation over its desired distance."""
    return vector(translation["direction"]["vector"]) * translation["desired_distance"]
