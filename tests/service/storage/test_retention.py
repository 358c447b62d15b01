"""Retention: what is removed by age or size, what is kept, and refusals when the disk is nearly full."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx2
import pytest

from calibration.atomic_write import write_synced
from recognition.request import RecognitionRequest
from service.clock import format_utc
from service.config.sections import RetentionConfig
from service.jobs.submission import Requester, new_scan
from service.states import ScanState
from service.storage.data_folder import DataFolder
from service.storage.idempotency_keys import Key
from service.storage.removal import remove
from service.storage.retention import sweep
from service.storage.rows import RecordingRow, ScanErrorRow
from service.storage.store import Store
from tests.service.conftest import Serve, wait_until
from tests.service.security.conftest import without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]

NOW = datetime(2026, 6, 1, tzinfo=UTC)
KIB = bytes(1024)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        yield store


def days_ago(days: float) -> str:
    """Return the time this many days before NOW."""
    return format_utc(NOW - timedelta(days=days))


def add_recording(store: Store, name: str, days: float) -> None:
    received = store.folder.incoming(name)
    write_synced(received, KIB)
    store.add_recording(RecordingRow(name, days_ago(days), len(KIB), "ab", 1, [], None, 0.0, {}), received)


def add_scan(store: Store, name: str, days: float, **values: Any) -> None:
    """Add a scan that ended `days` before NOW, with 1 KiB of results, an event, a view and an idempotency key."""
    values = {"state": "succeeded", "ended_at": days_ago(days), "created_at": days_ago(days)} | values
    requester = Requester("ann", Key("ann", f"key of {name}", "hash"))
    row = replace(new_scan("replay", RecognitionRequest(), requester), id=name, **values)
    store.scans.add(row, requester.key_row(row))
    store.scans.set_view(name, 0, "recorded")
    store.folder.results(name).mkdir()
    write_synced(store.folder.results(name) / "model.json", KIB)


def run_sweep(store: Store, *, idle: Callable[[], bool] = lambda: True, **config: Any) -> bool:
    return sweep(store, RetentionConfig(**config), NOW, idle)


def scans(store: Store) -> set[str]:
    """Return the ids of all scans, and check that no file or row of a removed scan is left."""
    found = {row.id for row in store.scans.newest(100)}
    assert {path.name for path in (store.folder.root / "scans").iterdir()} == found
    with store.database.connection() as db:
        for table in ("events", "views", "idempotency_keys"):
            assert {row[0] for row in db.execute(f"SELECT DISTINCT scan FROM {table}")} in (found, set())
    return found


def recordings(store: Store) -> set[str]:
    """Return the ids of all recordings, and check that they are those of the files."""
    found = {row.id for row in store.recordings(100)}
    assert {path.stem for path in (store.folder.root / "recordings").iterdir()} == found
    return found


def test_old_scans_are_removed_with_their_data(store: Store) -> None:
    for name in ("shared", "own", "wanted", "lone", "fresh"):
        add_recording(store, name, 40 if name != "fresh" else 1)
    add_scan(store, "old", 40, recording="shared")
    add_scan(store, "older", 50, recording="own", state="failed")
    add_scan(store, "young", 29, recording="shared", source="old")
    add_scan(store, "marked", 99, recording="wanted", kept=True)
    add_scan(store, "again", 60, recording="wanted", source="marked")
    assert run_sweep(store, max_age_days=30)
    assert scans(store) == {"young", "marked"}
    assert recordings(store) == {"shared", "wanted", "fresh"}
    young = store.scans.get("young")
    assert young is not None
    assert young.source is None  # the source was removed


def test_the_oldest_scans_are_removed_until_the_size_fits(store: Store) -> None:
    for number in range(6):  # 2 KiB each
        add_recording(store, f"r{number}", 10 - number)
        add_scan(store, f"s{number}", 10 - number, recording=f"r{number}", kept=number == 0)
    assert run_sweep(store, max_bytes=6 * 1024)
    assert scans(store) == {"s0", "s4", "s5"}
    assert recordings(store) == {"r0", "r4", "r5"}
    assert run_sweep(store, max_bytes=6 * 1024)
    assert len(scans(store)) == 3


@pytest.mark.parametrize("state", ["queued", "scanning", "processing", "stopping"])
def test_active_and_recent_scans_are_kept(store: Store, state: ScanState) -> None:
    add_recording(store, "r", 99)
    add_scan(store, "active", 99, recording="r", state=state, ended_at=None)
    add_scan(store, "just-ended", 0.5 / 24)
    add_recording(store, "just-sent", 0.5 / 24)
    assert run_sweep(store, max_age_days=0.001, max_bytes=1)
    assert (scans(store), recordings(store)) == ({"active", "just-ended"}, {"r", "just-sent"})


def test_the_removal_ends_when_a_job_starts(store: Store) -> None:
    for number in range(3):
        add_scan(store, f"s{number}", 99)
    free = iter([True, False])
    assert not run_sweep(store, idle=lambda: next(free), max_age_days=1)
    assert len(scans(store)) == 2


def test_nothing_is_removed_by_default(store: Store) -> None:
    add_scan(store, "old", 9999)
    assert run_sweep(store)
    assert scans(store) == {"old"}


def test_the_calibration_error_of_a_removed_scan_is_kept(store: Store) -> None:
    add_scan(store, "old", 99)
    scan_error = ScanErrorRow("old", "sha", [0.0] * 6, [[0.0] * 6] * 6, [0.0] * 6)
    store.calibrations.add_scan_error(scan_error)
    assert run_sweep(store, max_age_days=30)
    assert scans(store) == set()
    assert store.calibrations.scan_errors("sha", 5) == [scan_error]


def test_a_scan_that_was_marked_meanwhile_is_kept(store: Store) -> None:
    add_scan(store, "old", 99)
    store.scans.keep("old", True)
    assert remove(store, "scan", "old") is None
    assert scans(store) == {"old"}


def test_a_failed_write_removes_no_file(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    add_scan(store, "old", 99)
    with store.database.transaction() as db:
        db.execute("CREATE TRIGGER no BEFORE DELETE ON scans BEGIN SELECT RAISE(ABORT, 'no'); END")
    with pytest.raises(sqlite3.IntegrityError):
        remove(store, "scan", "old")
    assert scans(store) == {"old"}
    assert store.key("ann", "key of old") is not None


def test_the_service_removes_old_scans_and_refuses_jobs_that_may_not_fit(
    serve: Serve, tmp_path: Path, recording_file: Path, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as before:
        add_scan(before, "old", 99)
        add_scan(before, "marked", 99, kept=True)
    monkeypatch.setattr("service.storage.retention.STEADY_S", 0.0)
    limits = {"min_free_bytes": 10 * 2**20}
    with without_recognition(serve, tmp_path, retention={"max_age_days": 30}, limits=limits) as client:
        wait_until(lambda: client.get("/api/scans/old").status_code == 404)
        assert client.get("/api/scans/marked").status_code == 200

        content = recording_file.read_bytes()
        free = iter([10 * 2**20 + 1] + [10 * 2**20 - 1] * 5)
        monkeypatch.setattr("service.storage.disk_space.shutil.disk_usage", lambda _: SimpleNamespace(free=next(free)))
        # The free space suffices now, but not after the upload.
        assert "10.0 MiB are free" in assert_problem(
            client.post("/api/recordings", content=content), 507, "storage-full"
        )
        for path, body in [
            ("/api/scans", {"mode": "live"}),
            ("/api/scans", {"mode": "replay", "recording": "r"}),
            ("/api/scans/marked/reprocess", {}),
            ("/api/calibration/runs", {}),
            ("/api/calibration/verify", None),
        ]:
            answer = client.post(path, json=body, headers={"Idempotency-Key": path})
            assert "retention" in assert_problem(answer, 507, "storage-full"), path
        store: Store = client.app.state.context.store
        assert [row.id for row in store.scans.newest(10)] == ["marked"]
        assert store.recordings(10) == []
        assert store.key("local", "/api/scans") is None
        assert client.get("/api/cell").json()["state"] == "not_ready"  # no device was connected
