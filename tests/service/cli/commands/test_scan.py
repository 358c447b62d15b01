"""`pointchain scan` in its own process, with the real ur_rtde and depthai and a virtual controller."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from cell.process.child import Child
from cell.recording import read_recording, read_result
from cell.simulation.ur_controller.admin_client import AdminClient
from service.processing.results import Source, recognise_recording
from tests.cell.arm.pendant import Pendant
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.signalled import assert_stopped, interrupt

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

TIMEOUT_S = 120
"""Timeout, seconds. A busy machine needs time to load the libraries."""
SLIDER = {1: 0.5, 7: 0.25, 8: 0.02}
"""Positions of the speed slider after views of eight. The path home is short, and a busy machine is late: the first
call loads ur_rtde, and after the last one the path home takes a minute."""


@contextmanager
def scanning(folder: Path, host: str, time_factor: float, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Run `pointchain scan scan.mcap` in `folder`, with a fast simulated cell."""
    (folder / "cell.toml").write_text(
        f"[arm]\nhost = '{host}'\ntime_factor = {time_factor}\nwatchdog_hz = 1.0\n"
        "[camera]\nmodel = 'exact'\nfps = 30\nexposures = 1\nsettle_s = 0.0\n[scan]\nstring_radius_m = 0.0042\n"
    )
    command = [sys.executable, "-c", "import sys; from service.cli.main import main; sys.exit(main(sys.argv[1:]))"]
    command += ["scan", str(folder / "scan.mcap"), "--config", str(folder / "cell.toml"), *options]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as running:
        try:
            yield running
        finally:
            running.kill()


def test_the_model_goes_to_stdout_and_the_recording_gives_the_same(tmp_path: Path) -> None:
    with scanning(tmp_path, free_host(), 20.0) as running:
        out, err = running.communicate(timeout=TIMEOUT_S)
    assert running.returncode == 0, err
    model = json.loads(out)
    assert (len(model["chains"]), len(model["crossings"])) == (1, 1)
    assert "view 0 recorded" in err
    assert_summary(err, model)
    recording = tmp_path / "scan.mcap"
    sha256 = hashlib.sha256(recording.read_bytes()).hexdigest()
    assert model["provenance"]["recording_sha256"] == sha256
    recorded = read_result(recording)
    assert recorded is not None
    # A recording cannot contain its own hash.
    assert recorded["provenance"].pop("recording_sha256") is None
    recorded["provenance"]["recording_sha256"] = sha256
    assert recorded == model
    again = json.loads(json.dumps(recognise_recording(recording, source=Source(None, sha256)).model.to_json()))
    for each in (model, again):
        each.pop("timing_s")
    assert again == model


def assert_summary(err: str, model: dict[str, Any]) -> None:
    """Check that stderr ends with the verdict and the findings of a model of one chain with one crossing."""
    quality = model["quality"]
    begin = err.index(f"chains: 1, crossings: 1, verdict: {quality['verdict']}\n")
    assert err[begin:].splitlines()[1:] == [
        f"pointchain scan: {found['severity']}: {found['message']} [{found['code']}]" for found in quality["findings"]
    ]


def test_the_verdict_and_the_doubts_go_to_stderr(tmp_path: Path) -> None:
    """With 5.7 mm as radius of the string of 4.2 mm, the model has a doubt about its only chain."""
    with scanning(tmp_path, free_host(), 20.0, "--radius", "0.0057", "--all-grasps") as running:
        out, err = running.communicate(timeout=TIMEOUT_S)
    assert running.returncode == 0, err
    model = json.loads(out)
    assert model["quality"]["verdict"] == "review"
    assert [found["code"] for found in model["quality"]["findings"]] == ["radius-much-smaller"]
    assert_summary(err, model)
    assert model["grasps"]
    assert not any(grasp["trusted"] for grasp in model["grasps"])


@pytest.mark.parametrize(
    ("number", "taken"),
    [(signal.SIGINT, 1), (signal.SIGTERM, 1), (signal.SIGINT, 8)],  # after the last view the arm moves home
)
def test_a_signal_stops_the_arm_and_the_views_are_kept(tmp_path: Path, number: signal.Signals, taken: int) -> None:
    host = free_host()
    with (
        scanning(tmp_path, host, 2.0) as running,
        closing(Child("pendant", Pendant, host)) as pendant,
    ):
        assert running.stderr is not None
        for view in range(1, taken + 1):
            while f"recorded, {view} of 8" not in (line := running.stderr.readline()):
                assert line, "the command ended"
            if taken == 8 and view in SLIDER:
                pendant.call("slide_speed", SLIDER[view], timeout_s=TIMEOUT_S)
        out, err, events = interrupt(running, host, number, TIMEOUT_S)
    assert running.returncode == 130, err
    assert json.loads(out)["error"]["type"] == "urn:pointchain:stopped", out
    views = read_recording(tmp_path / "scan.mcap").views
    assert f"the views taken until then are in {tmp_path / 'scan.mcap'}: {len(views)}\n" in err
    assert "drop its task" not in err
    assert taken <= len(views) <= max(taken, 7)
    assert_stopped(events)


@pytest.mark.parametrize(("connected", "after_s"), [(False, 0.3), (False, 0.5), (True, 0.0)])
def test_a_signal_before_the_first_move_ends_the_scan(tmp_path: Path, connected: bool, after_s: float) -> None:
    # the signal comes while the cell connects or plans; the recognition process starts at the same time
    host = free_host()
    with scanning(tmp_path, host, 2.0) as running:
        assert running.stderr is not None
        assert "connecting" in running.stderr.readline()
        time.sleep(after_s)
        if connected:
            with closing(AdminClient(host)) as controller:
                wait_until(lambda: is_program_running(controller))
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: a process that is starting gets it too
        out, err = running.communicate(timeout=TIMEOUT_S)
    assert running.returncode == 130, err
    assert json.loads(out)["error"]["detail"] == "stopped by request"
    assert "Traceback" not in err
    assert not (tmp_path / "scan.mcap").exists()


def is_program_running(controller: AdminClient) -> bool:
    """Return whether our program runs on the robot."""
    try:
        return controller.state().program_state == "PLAYING"
    except ConnectionError:  # the controller is still starting
        return False
