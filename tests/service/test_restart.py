"""What a service that was killed leaves to the next one."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from service.data_folder import DataFolder
from service.store import Store

ROOT = Path(__file__).resolve().parents[2]
SERVE = """
import uvicorn
from service.app import create_app
from service.config import load_config
config = load_config()
uvicorn.run(create_app(config), host=config.host, port=config.port)
"""


@contextmanager
def process(data_dir: Path, log: Path) -> Iterator[tuple[subprocess.Popen[bytes], httpx.Client]]:
    """A service in a process of its own."""
    environment = os.environ | {"POINTCHAIN_DATA_DIR": str(data_dir), "POINTCHAIN_PORT": "0"}
    with log.open("wb") as output:
        running = subprocess.Popen(
            [sys.executable, "-c", SERVE], cwd=ROOT, env=environment, stdout=output, stderr=output
        )
    try:
        while not (address := re.search(r"running on (http://\S+)", log.read_text())):
            assert running.poll() is None, log.read_text()
            time.sleep(0.02)
        with httpx.Client(base_url=address[1], timeout=60) as client:
            yield running, client
    finally:
        running.kill()
        running.wait()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for left-over processes in /proc")
def test_killed_in_the_middle_of_a_scan(recording_file: Path, tmp_path: Path) -> None:
    data, content = tmp_path / "data", recording_file.read_bytes()
    with process(data, tmp_path / "first.log") as (first, client):
        recording = client.post("/api/recordings", content=content).json()
        wish = {"mode": "replay", "recording": recording["id"]}
        done = client.post("/api/scans", json=wish).headers["location"]
        while client.get(done).json()["state"] in ("queued", "processing"):
            time.sleep(0.02)
        finished = client.get(done).json()
        model = client.get(finished["links"]["model"]).content
        children = child_processes(first.pid)
        # Frozen, the recognition process cannot finish the second scan before the kill.
        for child in children:
            os.kill(child, signal.SIGSTOP)
        cut = client.post("/api/scans", json=wish).headers["location"]
        first.kill()
        first.wait()
    for child in children:
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

        again = client.post("/api/scans", json=wish)
        assert again.status_code == 202
        # Stopped in order this time, while the scan is under way or just done.
        second.send_signal(signal.SIGTERM)
        assert second.wait(timeout=60) in (0, -signal.SIGTERM)

    deadline = time.monotonic() + 60
    while [child for child in children if Path(f"/proc/{child}").exists() and not defunct(child)]:
        assert time.monotonic() < deadline, "the killed service left a process behind"
        time.sleep(0.02)

    folder = DataFolder(data)
    store = Store(folder)
    scan = store.scan(again.json()["id"])
    assert scan is not None
    # Where it was done before the signal came, there was nothing to interrupt.
    assert scan.state in ("interrupted", "succeeded")
    store.close()
    folder.close()


def child_processes(pid: int) -> list[int]:
    """The recognition process, and what Python keeps beside it."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()] or [
        int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]


def defunct(pid: int) -> bool:
    """Ended, but nobody has asked how: containers often have no process that does."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
