"""Fault 19: the disk is full at each write of the service."""

import hashlib
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import pytest

from recognition.request import RecognitionRequest
from service.cli.commands.serve import serve as serve_on_socket
from service.config.loader import ServiceConfig
from service.integrity.check import check_store
from service.jobs.submission import NOBODY, new_scan
from service.security.audit.reader import read_audit
from service.states import ACTIVE_STATES
from service.storage.data_folder import DataFolder
from service.storage.database import new_id
from service.storage.removal import oldest_first, remove
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.faults.full_disk import FullDisk, full_disk
from tests.service.faults.recognition_stub import RecognitionStub, describe_here, stub_factory
from tests.service.live_cell import LiveCell, live_cell
from tests.service.stored_data import check_target_of

pytestmark = [pytest.mark.fault(19), pytest.mark.xdist_group("service")]

Problem = Callable[[httpx2.Response, int, str], str]
Make = Callable[[], RecognitionStub]
UNLIMITED = {"min_free_bytes": 0}
FULL = "urn:pointchain:storage-full"


@pytest.fixture(scope="module")
def recognition(recording_file: Path) -> Make:
    """A factory of stubs of recognition."""
    return stub_factory(recording_file)


@pytest.fixture
def fast_stubs(monkeypatch: pytest.MonkeyPatch, recognition: Make) -> None:
    """Replace the slow parts that do not concern the disk."""
    monkeypatch.setattr("service.jobs.manager.RecognitionWorker", recognition)
    monkeypatch.setattr("service.jobs.runner.RETRY_S", 0.02)
    monkeypatch.setattr("service.api.routes.recordings.describe_untrusted_recording", describe_here)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch, fast_stubs: None) -> FullDisk:
    """A simulated disk for the service of this process."""
    return full_disk(monkeypatch)


def assert_consistent(data: Path) -> None:
    """Assert that each row has its complete files, each file has its row, and no partial file is left."""
    assert check_store(check_target_of(data), running=False).findings == ()


def wait_for_end(client: httpx2.Client, location: str, disk: FullDisk) -> dict[str, Any]:
    """Wait for the end of a scan and return its document. Make space after three refused writes."""
    found: dict[str, Any] = {}

    def over() -> bool:
        found.update(client.get(location).json())  # reads are answered on a full disk
        if disk.refused >= 3:
            disk.clear()
        return found["state"] not in ACTIVE_STATES

    wait_until(over)
    disk.clear()
    return found


class Replays:
    """A client that sends a recording and has it recognised."""

    def __init__(self, client: ServedClient, content: bytes, disk: FullDisk) -> None:
        self.client, self.content, self.disk = client, content, disk

    def run(self) -> tuple[int, dict[str, Any] | None]:
        """Upload and recognise a recording. Return the status of the first refusal or the last answer, and the scan."""
        sent = self.client.post("/api/recordings", content=self.content)
        if sent.status_code != 201:
            return assert_storage_full(sent), None
        body = {"mode": "replay", "recording": sent.json()["id"]}
        started = self.client.post("/api/scans", json=body)
        if started.status_code != 202:
            return assert_storage_full(started), None
        scan = wait_for_end(self.client, started.headers["Location"], self.disk)
        if scan["links"]["preview"]:  # waits until the runner has finished the scan
            self.client.get(scan["links"]["preview"])
        return 202, scan

    def check_write(self, write: int) -> None:
        """Fill the disk from this write on, and assert that the failure is reported and the data consistent."""
        self.disk.fill(write)
        status, scan = self.run()
        self.disk.clear()
        site = self.disk.sites[write - 1]
        if scan is None:
            assert status == 507, site
        elif scan["state"] == "succeeded":
            assert site in ("run", "add_file"), f"{site}: only the preview or its hash may be missing"
        else:
            assert (scan["state"], scan["problem"]["type"], scan["problem"]["status"]) == ("failed", FULL, 507), site
            assert scan["links"]["model"] is None
        assert_consistent(self.client.app.state.context.config.data_dir)


@pytest.fixture
def replays(serve: Serve, tmp_path: Path, recording_file: Path, disk: FullDisk) -> Iterator[Replays]:
    """A client of a service on the simulated disk."""
    with serve(tmp_path / "data", limits=UNLIMITED) as client:
        yield Replays(client, recording_file.read_bytes(), disk)


def test_a_full_disk_at_any_write_of_an_upload_or_replay_loses_nothing(replays: Replays) -> None:
    replays.disk.fill(None)
    status, scan = replays.run()
    assert (status, scan and scan["state"]) == (202, "succeeded")
    sites = list(replays.disk.sites)
    assert {"finish", "add_recording", "add", "write_results"} <= set(sites)
    # The writes of the stages are alike, so one of them is tested.
    alike = [index for index in range(1, len(sites)) if sites[index - 1] == sites[index] == "on_stage"]
    for write in range(1, len(sites) + 1):
        if write not in alike[1:]:
            replays.check_write(write)
    status, scan = replays.run()
    assert (status, scan and scan["state"]) == (202, "succeeded")


def assert_storage_full(answer: httpx2.Response) -> int:
    """Assert that the answer reports a full disk and return its status."""
    assert answer.json()["type"] == FULL, answer.text
    return answer.status_code


@pytest.fixture
def cell(serve: Serve, tmp_path: Path, disk: FullDisk) -> Iterator[LiveCell]:
    """A live cell on the simulated disk."""
    with live_cell(serve, tmp_path / "data", limits=UNLIMITED) as cell:
        yield cell


SECOND_INTENT = 10
"""Number of the write with the intent to move to the second viewpoint of a live scan.

The writes before it are the scan's row, its state (twice), the recording's file and name, and the intent, data, row and
progress of the first view.
"""


def live_once(cell: LiveCell, disk: FullDisk, write: int | None) -> tuple[list[str], dict[str, Any] | None]:
    """Run a live scan of two views with the disk full from this write on. Return its writes and the scan."""
    cell.is_well()
    disk.fill(write)
    answer = cell.client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042, "views": 2})
    if answer.status_code != 202:
        disk.clear()
        assert assert_storage_full(answer) == 507
        return disk.sites, None
    scan = wait_for_end(cell.client, answer.headers["Location"], disk)
    if scan["links"]["preview"]:
        cell.client.get(scan["links"]["preview"])
    wait_until(lambda: cell.state()["state"] != "busy")
    return disk.sites, scan


def check_live_write(cell: LiveCell, disk: FullDisk, write: int) -> None:
    """Fill the disk from this write of a live scan on, and assert that the scan fails without loss."""
    sites, scan = live_once(cell, disk, write)
    site = sites[write - 1] if len(sites) >= write else "none"
    assert not cell.moving(), site
    data = cell.client.app.state.context.config.data_dir
    if scan is not None and scan["state"] == "failed":
        assert scan["problem"]["type"] == FULL, site
        # Each acknowledged view is in the recording. The integrity check compares its bytes.
        kept = [view["state"] for view in scan["progress"]["views"]].count("recorded")
        assert kept == 0 or cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] >= kept
    elif scan is not None:
        assert scan["state"] == "succeeded", scan
        assert site in ("run", "none", "add_file", "add_scan_error"), (
            f"{site}: only the preview, its hash, or the record of the scan error may be missing"
        )
    assert_consistent(data)


def test_a_full_disk_at_the_intent_prevents_the_move(cell: LiveCell, disk: FullDisk) -> None:
    _, scan = live_once(cell, disk, SECOND_INTENT)
    assert scan is not None
    assert (disk.sites[SECOND_INTENT - 2 : SECOND_INTENT], scan["problem"]["type"]) == (
        ["update", "set_view"],
        FULL,
    )
    assert cell.events("motion_start", after_s=disk.first_refused_s) == [], "the arm moved without a stored intent"
    assert [view["state"] for view in scan["progress"]["views"]].count("recorded") == 1
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 1
    assert_consistent(cell.client.app.state.context.config.data_dir)
    _, scan = live_once(cell, disk, None)
    assert scan is not None
    assert scan["state"] == "succeeded"


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_a_full_disk_at_any_write_of_a_live_scan_loses_nothing(cell: LiveCell, disk: FullDisk) -> None:
    sites, scan = live_once(cell, disk, None)
    assert scan is not None
    assert scan["state"] == "succeeded"
    assert {"write_view", "set_view", "close", "add_scan_recording", "finish"} <= set(sites), sites
    for write in range(1, len(sites) + 1):
        check_live_write(cell, disk, write)


# A real file system

SPACE = 6 << 20
"""Size of the small file system, bytes."""


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Mount a small file system at `folder`, or skip the test without root rights."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SPACE}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("the program mount is not installed")
    if done.returncode != 0:
        pytest.skip(f"only root can mount a file system: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path, leave_bytes: int) -> Path:
    """Write a file that fills the disk except for `leave_bytes`, and return its path."""
    path = folder / "filler"
    with path.open("wb", buffering=0) as file:
        with suppress(OSError):
            while True:
                file.write(bytes(4096))
        file.truncate(max(0, file.tell() - leave_bytes))
    return path


Mounted = Callable[[Path], AbstractContextManager[Path]]


@pytest.mark.parametrize(
    "steps",
    [
        pytest.param((0, 6, 40), id="some"),
        pytest.param(tuple(range(0, 80)), marks=[pytest.mark.soak, pytest.mark.timeout(3600)], id="each"),
    ],
)
def test_a_full_file_system_loses_nothing(
    serve: Serve,
    tmp_path: Path,
    recording_file: Path,
    fast_stubs: None,
    assert_problem: Problem,
    steps: tuple[int, ...],
) -> None:
    content, kept = recording_file.read_bytes(), []
    with small_disk(tmp_path / "disk") as data, serve(data, limits=UNLIMITED) as client:
        replays = Replays(client, content, FullDisk())
        _, scan = replays.run()
        assert scan is not None
        kept.append(scan["recording"])
        for step in steps:
            filler = fill(data, leave_bytes=step * 4096)
            sent = client.post("/api/recordings", content=content)
            assert step or sent.status_code == 507, "the disk is not full"
            if sent.status_code == 201:
                kept.append(sent.json()["id"])
            else:
                assert_problem(sent, 507, "storage-full")
            started = client.post("/api/scans", json={"mode": "replay", "recording": kept[-1]})
            assert client.get(f"/api/recordings/{kept[0]}").status_code == 200
            filler.unlink()  # makes space
            if started.status_code == 202:
                scan = wait_for_end(client, started.headers["Location"], FullDisk())
                if scan["state"] != "succeeded":
                    assert (scan["state"], scan["problem"]["type"]) == ("failed", FULL)
                else:
                    client.get(scan["links"]["preview"])
            else:
                assert_problem(started, 507, "storage-full")
            assert_consistent(data)
            assert replays.run()[0] == 202
            remove_all_but_first(client, kept[0])
            kept = kept[:1]
        recording = client.get(f"/api/recordings/{kept[0]}").json()
        assert hashlib.sha256(client.get(recording["links"]["file"]).content).hexdigest() == recording["sha256"]


def test_a_service_starts_on_a_full_disk_and_writes_when_there_is_space(
    serve: Serve, tmp_path: Path, recording_file: Path, fast_stubs: None, assert_problem: Problem
) -> None:
    content = recording_file.read_bytes()
    with small_disk(tmp_path / "disk") as data:
        with serve(data, limits=UNLIMITED) as client:
            _, scan = Replays(client, content, FullDisk()).run()
            assert scan is not None
            running = replace(new_scan("live", RecognitionRequest(), NOBODY), id=new_id(), state="scanning")
            client.app.state.context.store.scans.add(running)  # as if the service had been killed during this scan
        filler = fill(data, leave_bytes=0)
        with serve(data, limits=UNLIMITED) as client:
            assert client.get("/").status_code == 200
            assert client.get(scan["links"]["self"]).json() == scan
            assert client.get(scan["links"]["model"]).status_code == 200
            reason = assert_problem(client.get("/readyz"), 503, "not-ready")
            assert "store: it accepts no changes: the disk is full" in reason
            assert "disk: 0 MiB are free" in reason
            assert_problem(client.post("/api/recordings", content=content), 507, "storage-full")
            refused = client.post("/api/scans", json={"mode": "replay", "recording": scan["recording"]})
            assert_problem(refused, 507, "storage-full")
            assert client.get(f"/api/scans/{running.id}").json()["state"] == "scanning"
            filler.unlink()
            wait_until(lambda: client.get("/readyz").status_code == 200)
            wait_until(lambda: client.get(f"/api/scans/{running.id}").json()["state"] == "interrupted")
            assert Replays(client, content, FullDisk()).run()[0] == 202
        assert_consistent(data)
        written = [entry.what for entry in read_audit(data, None, None, None, 100)]
        assert written.count("start") == 2  # also that of the start on the full disk


def test_a_full_disk_without_tables_is_said_at_the_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with small_disk(tmp_path / "disk") as data:
        DataFolder(data).close()
        fill(data, leave_bytes=0)
        assert serve_on_socket(ServiceConfig(data_dir=data, port=0)) == 1
        assert check_store(check_target_of(data)).findings == ()  # nothing half-made is left
    message = capsys.readouterr().err
    assert "no space is left for the database, which this release must make or change: free some" in message
    assert "Traceback" not in message


def remove_all_but_first(client: ServedClient, first: str) -> None:
    """Remove all data except one recording, as retention does."""
    store = client.app.state.context.store
    wait_until(lambda: client.app.state.context.jobs.idle)
    for old in oldest_first(store, "9999"):
        row = store.scans.get(old.id) if old.kind == "scan" else None
        if row is None or row.recording != first:
            remove(store, old.kind, old.id)
