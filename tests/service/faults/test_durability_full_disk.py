"""Fault 19: the disk is full, at each of the writes that the service makes."""

import hashlib
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.integrity.check import check_store
from service.states import ACTIVE_STATES
from service.storage.removal import oldest_first, remove
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.faults.full_disk import FullDisk, full_disk
from tests.service.faults.pretended_recognition import PretendedRecognition, describe_here, pretended
from tests.service.live_cell import LiveCell, live_cell
from tests.service.stored_data import check_target_of

pytestmark = [pytest.mark.fault(19), pytest.mark.xdist_group("cell")]

Problem = Callable[[httpx2.Response, int, str], str]
Make = Callable[[], PretendedRecognition]
UNLIMITED = {"min_free_bytes": 0}
FULL = "urn:pointchain:storage-full"


@pytest.fixture(scope="module")
def recognition(recording_file: Path) -> Make:
    return pretended(recording_file)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, recognition: Make) -> None:
    """What is not about the disk takes no time."""
    monkeypatch.setattr("service.jobs.manager.RecognitionWorker", recognition)
    monkeypatch.setattr("service.jobs.runner.RETRY_S", 0.02)
    monkeypatch.setattr("service.api.routes.recordings.describe_untrusted_recording", describe_here)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch, quick: None) -> FullDisk:
    return full_disk(monkeypatch)


def assert_sound(data: Path) -> None:
    """Each row has its files, whole, each file its row, and nothing half-written is left."""
    assert check_store(check_target_of(data), running=False).findings == ()


def ended(client: httpx2.Client, location: str, disk: FullDisk) -> dict[str, Any]:
    """The scan's document once it has ended; there is space again when its end was refused some times."""
    found: dict[str, Any] = {}

    def over() -> bool:
        found.update(client.get(location).json())  # whatever is full, it is answered
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

    def once(self) -> tuple[int, dict[str, Any] | None]:
        """Status of the first answer that was refused, else the last one's; and the scan, if it came to one."""
        sent = self.client.post("/api/recordings", content=self.content)
        if sent.status_code != 201:
            return _full(sent), None
        wish = {"mode": "replay", "recording": sent.json()["id"]}
        begun = self.client.post("/api/scans", json=wish)
        if begun.status_code != 202:
            return _full(begun), None
        scan = ended(self.client, begun.headers["Location"], self.disk)
        if scan["links"]["preview"]:  # there, or not to be; the runner is done with the scan then
            self.client.get(scan["links"]["preview"])
        return 202, scan

    def refused_at(self, write: int) -> None:
        """The disk is full from this write on; all is well afterwards."""
        self.disk.fill(write)
        status, scan = self.once()
        self.disk.clear()
        site = self.disk.sites[write - 1]
        if scan is None:
            assert status == 507, site
        elif scan["state"] == "succeeded":
            assert site == "run", f"{site}: only the picture may be missing"
        else:
            assert (scan["state"], scan["problem"]["type"], scan["problem"]["status"]) == ("failed", FULL, 507), site
            assert scan["links"]["model"] is None
        assert_sound(self.client.app.state.context.config.data_dir)


@pytest.fixture
def replays(serve: Serve, tmp_path: Path, recording_file: Path, disk: FullDisk) -> Iterator[Replays]:
    with serve(tmp_path / "data", limits=UNLIMITED) as client:
        yield Replays(client, recording_file.read_bytes(), disk)


def test_at_each_write_of_an_upload_and_a_replay(replays: Replays) -> None:
    replays.disk.fill(None)
    status, scan = replays.once()
    assert (status, scan and scan["state"]) == (202, "succeeded")
    sites = list(replays.disk.sites)
    assert {"finish", "add_recording", "add", "write_results"} <= set(sites)
    # Those of the stages are alike.
    alike = [place for place in range(1, len(sites)) if sites[place - 1] == sites[place] == "on_stage"]
    for write in range(1, len(sites) + 1):
        if write not in alike[1:]:
            replays.refused_at(write)
    status, scan = replays.once()
    assert (status, scan and scan["state"]) == (202, "succeeded")


def _full(answer: httpx2.Response) -> int:
    assert answer.json()["type"] == FULL, answer.text
    return answer.status_code


@pytest.fixture
def cell(serve: Serve, tmp_path: Path, disk: FullDisk) -> Iterator[LiveCell]:
    with live_cell(serve, tmp_path / "data", limits=UNLIMITED) as cell:
        yield cell


SECOND_INTENT = 10
"""Of a live scan's writes, the intent to move to the second viewpoint: behind the scan's row, twice its state, the
recording's file and name, and of the first view the intent, the view, its row and the progress."""


def live_once(cell: LiveCell, disk: FullDisk, write: int | None) -> tuple[list[str], dict[str, Any] | None]:
    """One scan of two views, the disk full from this write on; the writes that it came to, and the scan."""
    cell.is_well()
    disk.fill(write)
    answer = cell.client.post("/api/scans", json={"mode": "live", "string_radius_m": 0.0042, "views": 2})
    if answer.status_code != 202:
        disk.clear()
        assert _full(answer) == 507
        return disk.sites, None
    scan = ended(cell.client, answer.headers["Location"], disk)
    if scan["links"]["preview"]:
        cell.client.get(scan["links"]["preview"])
    wait_until(lambda: cell.state()["state"] != "busy")
    return disk.sites, scan


def assert_live_failed(cell: LiveCell, disk: FullDisk, write: int) -> None:
    sites, scan = live_once(cell, disk, write)
    site = sites[write - 1] if len(sites) >= write else "none"
    assert not cell.moving(), site
    data = cell.client.app.state.context.config.data_dir
    if scan is not None and scan["state"] == "failed":
        assert scan["problem"]["type"] == FULL, site
        # Each view that was acknowledged is in the recording; the doctor looks at its bytes.
        kept = [view["state"] for view in scan["progress"]["views"]].count("recorded")
        assert kept == 0 or cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] >= kept
    elif scan is not None:
        assert scan["state"] == "succeeded", scan
        assert site in ("run", "none", "add_scan_error"), (
            f"{site}: only the picture or the watch over the calibration may miss it"
        )
    assert_sound(data)


def test_at_the_intent_of_a_move(cell: LiveCell, disk: FullDisk) -> None:
    _, scan = live_once(cell, disk, SECOND_INTENT)
    assert scan is not None
    assert (disk.sites[SECOND_INTENT - 2 : SECOND_INTENT], scan["problem"]["type"]) == (
        ["update", "set_view"],
        FULL,
    )
    assert cell.events("motion_start", after_s=disk.first_refused_s) == [], "the arm moves without its intent"
    assert [view["state"] for view in scan["progress"]["views"]].count("recorded") == 1
    assert cell.client.get(f"/api/recordings/{scan['recording']}").json()["views"] == 1
    assert_sound(cell.client.app.state.context.config.data_dir)
    _, scan = live_once(cell, disk, None)
    assert scan is not None
    assert scan["state"] == "succeeded"


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_at_each_write_of_a_live_scan(cell: LiveCell, disk: FullDisk) -> None:
    sites, scan = live_once(cell, disk, None)
    assert scan is not None
    assert scan["state"] == "succeeded"
    assert {"_sync", "set_view", "close", "add_scan_recording", "finish"} <= set(sites), sites
    for write in range(1, len(sites) + 1):
        assert_live_failed(cell, disk, write)


# A real one

SPACE = 6 << 20


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system with little space."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={SPACE}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("there is no program mount")
    if done.returncode != 0:
        pytest.skip(f"a file system can be mounted by root alone: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path, leave_bytes: int) -> Path:
    """A file that takes all the space there is, but for this."""
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
def test_on_a_disk_that_is_really_full(
    serve: Serve,
    tmp_path: Path,
    recording_file: Path,
    quick: None,
    assert_problem: Problem,
    steps: tuple[int, ...],
) -> None:
    content, kept = recording_file.read_bytes(), []
    with small_disk(tmp_path / "disk") as data, serve(data, limits=UNLIMITED) as client:
        replays = Replays(client, content, FullDisk())
        _, scan = replays.once()
        assert scan is not None
        kept.append(scan["recording"])
        for step in steps:
            filler = fill(data, leave_bytes=step * 4096)
            sent = client.post("/api/recordings", content=content)
            assert step or sent.status_code == 507, "it is not full"
            if sent.status_code == 201:
                kept.append(sent.json()["id"])
            else:
                assert_problem(sent, 507, "storage-full")
            begun = client.post("/api/scans", json={"mode": "replay", "recording": kept[-1]})
            assert client.get(f"/api/recordings/{kept[0]}").status_code == 200
            filler.unlink()  # there is space again
            if begun.status_code == 202:
                scan = ended(client, begun.headers["Location"], FullDisk())
                if scan["state"] != "succeeded":
                    assert (scan["state"], scan["problem"]["type"]) == ("failed", FULL)
                else:
                    client.get(scan["links"]["preview"])
            else:
                assert_problem(begun, 507, "storage-full")
            assert_sound(data)
            assert replays.once()[0] == 202
            remove_all_but_first(client, kept[0])
            kept = kept[:1]
        recording = client.get(f"/api/recordings/{kept[0]}").json()
        assert hashlib.sha256(client.get(recording["links"]["file"]).content).hexdigest() == recording["sha256"]


def remove_all_but_first(client: ServedClient, first: str) -> None:
    """Makes room, as retention does."""
    store = client.app.state.context.store
    wait_until(lambda: client.app.state.context.jobs.idle)
    for old in oldest_first(store, "9999"):
        row = store.scans.get(old.id) if old.kind == "scan" else None
        if row is None or row.recording != first:
            remove(store, old)
