"""`pointchain scan` as a person runs it: a process of its own, the real ur_rtde and depthai, a virtual controller."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from cell.process.child import Child
from cell.recording.writer import read_recording, read_result
from cell.simulation.ur_controller.admin_client import AdminClient
from service.processing.results import recognise_recording
from tests.cell.arm.pendant import Pendant
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.signalled import assert_stopped, told_to_end

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

LONGEST_S = 120
"""Loading the libraries on a busy machine, above all."""


@contextmanager
def scanning(folder: Path, host: str, time_factor: float) -> Iterator[subprocess.Popen[str]]:
    """`pointchain scan scan.mcap` in `folder`, by a quick simulated cell."""
    (folder / "cell.toml").write_text(
        f"[arm]\nhost = '{host}'\ntime_factor = {time_factor}\nwatchdog_hz = 1.0\n"
        "[camera]\nmodel = 'ideal'\nfps = 30\nexposures = 1\nsettle_s = 0.0\n[scan]\nstring_radius_m = 0.0042\n"
    )
    command = [sys.executable, "-c", "import sys; from service.cli.main import main; sys.exit(main(sys.argv[1:]))"]
    command += ["scan", str(folder / "scan.mcap"), "--config", str(folder / "cell.toml")]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as running:
        try:
            yield running
        finally:
            running.kill()


def test_the_model_goes_to_stdout_and_the_recording_gives_it_again(tmp_path: Path) -> None:
    with scanning(tmp_path, free_host(), 20.0) as running:
        out, said = running.communicate(timeout=LONGEST_S)
    assert running.returncode == 0, said
    model = json.loads(out)
    assert (len(model["chains"]), len(model["crossings"])) == (1, 1)
    assert "view 0 recorded" in said
    assert "chains: 1, crossings: 1" in said
    assert read_result(tmp_path / "scan.mcap") == model
    again = json.loads(json.dumps(recognise_recording(tmp_path / "scan.mcap").model.to_json()))
    for each in (model, again):
        each.pop("timing_s")
    assert again == model


@pytest.mark.parametrize(
    ("number", "taken"),
    [(signal.SIGINT, 1), (signal.SIGTERM, 1), (signal.SIGINT, 8)],  # with all taken, the arm is on its way home
)
def test_a_signal_stops_the_arm_first_and_the_views_are_kept(
    tmp_path: Path, number: signal.Signals, taken: int
) -> None:
    host = free_host()
    with (
        scanning(tmp_path, host, 2.0 if taken < 8 else 8.0) as running,
        closing(Child("pendant", Pendant, host)) as pendant,
    ):
        assert running.stderr is not None
        while f"recorded, {taken} of 8" not in (line := running.stderr.readline()):
            assert line, "it ended"
            if "recorded, 7 of 8" in line:  # the way home is short: slowly, from the last view's way on
                pendant.call("slide_speed", 1 / 8, timeout_s=20.0)
        out, said, seen = told_to_end(running, host, number, LONGEST_S)
    assert running.returncode == 130, said
    assert json.loads(out)["error"]["type"] == "urn:pointchain:stopped", out
    views = read_recording(tmp_path / "scan.mcap").views
    assert f"the views taken until then are in {tmp_path / 'scan.mcap'}: {len(views)}\n" in said
    assert "drop its task" not in said
    assert taken <= len(views) <= max(taken, 7)
    assert_stopped(seen)


@pytest.mark.parametrize(("connected", "after_s"), [(False, 0.3), (False, 0.5), (True, 0.0)])
def test_a_signal_before_the_arm_moves_ends_it_in_order(tmp_path: Path, connected: bool, after_s: float) -> None:
    # While it connects, or plans; recognition starts in a thread of its own meanwhile.
    host = free_host()
    with scanning(tmp_path, host, 2.0) as running:
        assert running.stderr is not None
        assert "connecting" in running.stderr.readline()
        time.sleep(after_s)
        if connected:
            with closing(AdminClient(host)) as controller:
                wait_until(lambda: holds(controller))
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: what is being started gets it too
        out, said = running.communicate(timeout=LONGEST_S)
    assert running.returncode == 130, said
    assert json.loads(out)["error"]["detail"] == "stopped by request"
    assert "Traceback" not in said
    assert not (tmp_path / "scan.mcap").exists()


def holds(controller: AdminClient) -> bool:
    """Whether our program is on the robot."""
    try:
        return controller.state().program_state == "PLAYING"
    except ConnectionError:  # it is only just being started
        return False
