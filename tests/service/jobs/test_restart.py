"""Restart after a kill: kept recordings and results, and interrupted scans."""

import hashlib
import json
import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from cell.recording import read_recording
from service.storage.data_folder import DataFolder
from service.storage.store import Store
from tests.cell.loopback import free_host
from tests.processes import children, runs
from tests.service.conftest import wait_until
from tests.service.service_process import process


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for left-over processes in /proc")
def test_a_kill_during_a_replay_keeps_earlier_results(recording_file: Path, tmp_path: Path) -> None:
    data, content = tmp_path / "data", recording_file.read_bytes()
    with process(data, tmp_path / "first.log") as (first, client):
        recording = client.post("/api/recordings", content=content).json()
        body = {"mode": "replay", "recording": recording["id"]}
        done = client.post("/api/scans", json=body).headers["location"]
        while client.get(done).json()["state"] in ("queued", "processing"):
            time.sleep(0.02)
        finished = client.get(done).json()
        model = client.get(finished["links"]["model"]).content
        # Clients are informed of the end before it is logged.
        wait_until(lambda: f"scan {finished['id']} succeeded" in (tmp_path / "first.log").read_text())
        started = children(first.pid)
        # Suspended, the recognition process cannot finish the second scan before the kill.
        for child in started:
            os.kill(child, signal.SIGSTOP)
        cut = client.post("/api/scans", json=body).headers["location"]
        first.kill()
        first.wait()
    for child in started:
        os.kill(child, signal.SIGCONT)

    with process(data, tmp_path / "second.log") as (second, client):
        assert client.get(f"/api/recordings/{recording['id']}").json() == recording
        assert client.get(recording["links"]["file"]).content == content
        assert client.get(done).json() == finished
        assert client.get(finished["links"]["model"]).content == model
        interrupted = client.get(cut).json()
        assert interrupted["state"] == "interrupted"
        assert interrupted["problem"]["type"] == "urn:pointchain:interrupted"
        assert interrupted["links"]["model"] is None
        lines = logged(tmp_path / "second.log")
        (warning,) = [line for line in lines if "interrupted" in line["message"]]
        assert (warning["scan"], warning["level"]) == (interrupted["id"], "warning")
        assert lines[0]["message"].startswith("pointchain: http://")
        # The log of the first service has the scan from its request to its end. Each line has the id of the scan.
        lines = [line for line in logged(tmp_path / "first.log") if line.get("scan") == finished["id"]]
        lines = [line for line in lines if line.get("method") != "GET"]
        assert {line["message"].split(" in ")[0].split(" after ")[0] for line in lines} == {
            "POST /api/scans 202",
            f"scan {finished['id']} begins: replay of recording {recording['id']}",
            f"scan {finished['id']} succeeded",
        }

        again = client.post("/api/scans", json=body)
        assert again.status_code == 202
        # This service shuts down cleanly, during the scan or just after it.
        second.send_signal(signal.SIGTERM)
        assert second.wait(timeout=60) == 0

    wait_for_end(started)
    folder = DataFolder(data)
    store = Store(folder)
    scan = store.scans.get(again.json()["id"])
    assert scan is not None
    # A scan that ended before the signal is not interrupted.
    assert scan.state in ("interrupted", "succeeded")
    store.close()
    folder.close()


@pytest.mark.xdist_group("service")  # one at a time, because the test runs several busy processes
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for left-over processes in /proc")
def test_a_kill_during_a_live_scan_keeps_its_views(tmp_path: Path) -> None:
    data, host = tmp_path / "data", free_host()
    variables = {
        "POINTCHAIN_ARM__HOST": host,
        "POINTCHAIN_ARM__TIME_FACTOR": "5",
        "POINTCHAIN_ARM__WATCHDOG_HZ": "1",
        "POINTCHAIN_CAMERA__MODEL": "exact",
        "POINTCHAIN_CAMERA__FPS": "30",
        "POINTCHAIN_CAMERA__EXPOSURES": "1",
    }
    with process(data, tmp_path / "first.log", **variables) as (first, client):
        answer = client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042})
        assert answer.status_code == 202, answer.text
        location = answer.headers["location"]

        def acknowledged() -> set[int]:
            views = client.get(location).json()["progress"]["views"]
            return {view["index"] for view in views if view["state"] == "recorded"}

        deadline = time.monotonic() + 120
        while len(acknowledged()) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        kept = acknowledged()
        started = children(first.pid)
        first.kill()
        first.wait()
    wait_for_end(started)  # also the driver of the arm and its simulated controller

    with process(data, tmp_path / "second.log", **variables) as (_, client):
        scan = client.get(location).json()
        assert (scan["state"], scan["problem"]["type"]) == ("interrupted", "urn:pointchain:interrupted")
        assert scan["problem"]["status"] == 500  # the same status as after a shutdown
        assert client.get("/api/cell").json()["state"] == "not_ready"  # the cell does not continue without a request
        recording = client.get(f"/api/recordings/{scan['recording']}").json()
        content = client.get(scan["links"]["recording"]).content
    assert hashlib.sha256(content).hexdigest() == recording["sha256"]
    (tmp_path / "kept.mcap").write_bytes(content)
    views = {view.index for view in read_recording(tmp_path / "kept.mcap").views}
    # The last view may have been on the disk before its row was.
    assert kept <= views
    assert len(views) == recording["views"] < 8


def logged(file: Path) -> list[dict[str, Any]]:
    """Return the documents of a log file. Each line must be JSON."""
    return [json.loads(line) for line in file.read_text().splitlines()]


def wait_for_end(started: set[int]) -> None:
    """Wait until all these processes have ended."""
    deadline = time.monotonic() + 60
    while any(map(runs, started)):
        assert time.monotonic() < deadline, "a process of the killed service still runs"
        time.sleep(0.02)
