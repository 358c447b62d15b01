"""The integrity check finds rows that the service cannot return, and the repair keeps what belongs to them."""

import json
import shutil
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from recognition.request import RecognitionRequest
from service.api.schemas.calibration_resources import run_resource
from service.api.schemas.scan_resource import scan_resources
from service.integrity.check import check_store
from service.integrity.repair import repair
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.store import Store
from tests.service.stored_data import LIVE, REPLAY, SUMMARY, UPLOAD, Data, check_target_of

VERIFICATION = {
    "passed": True, "message": "well", "max_deviation_m": 0.001, "expected_m": 0.001, "board_displacement_m": None,
    "max_deviation_rad": 0.001, "expected_rad": 0.001, "board_rotation_rad": None,
    "views": [],
}  # fmt: skip


def assert_lists_are_readable(data: Data) -> None:
    """Check that the service can return the lists of scans and calibrations."""
    folder = DataFolder(data.root)
    store = Store(folder)
    try:
        scans, runs = store.scans.newest(100), store.calibrations.newest(100, None)
        scan_resources(scans, store.scans.views([scan.id for scan in scans]))
        for run in runs:
            run_resource(run, store.calibrations.views([run.id]))
    finally:
        store.close()
        folder.close()


@pytest.mark.parametrize(
    ("column", "value", "repaired"),
    [
        ("state", "banana", "succeeded"),
        ("fraction", 7.0, 1.0),
        ("stage", b"\xff", None),
        ("summary", "5", json.dumps(SUMMARY)),
        ("failure", '["no failure"]', None),
        ("files", '{"model.json": 5}', None),
        ("inputs", "{not json", None),
        ("source", "No Id", None),
    ],
)
def test_an_unreadable_scan_keeps_its_result(data: Data, column: str, value: object, repaired: object) -> None:
    names = [name for name in vars(new_scan("replay", RecognitionRequest(), NOBODY)) if name != column]
    others = f"SELECT {', '.join(names)} FROM scans WHERE id = ?"
    before = data.row(others, REPLAY)
    data.change(f"UPDATE scans SET {column} = ? WHERE id = ?", value, REPLAY)
    (finding,) = check_store(data.store).findings
    assert (finding.code, finding.group) == ("row-unreadable", "database")
    assert "\n" not in finding.what
    data.repair()
    assert data.row(f"SELECT {column} FROM scans WHERE id = ?", REPLAY) == (repaired,)
    assert data.row(others, REPLAY) == before
    assert (data.root / "scans" / REPLAY / "model.json").read_bytes() == b'{"chains": []}'
    assert data.row("SELECT recording, state FROM scans WHERE id = ?", REPLAY) == (UPLOAD, "succeeded")
    assert data.original(f"SELECT {column} FROM scans WHERE id = ?", REPLAY) == (value,)
    assert_lists_are_readable(data)


@pytest.mark.parametrize(
    "sql", ["scans SET requested_by = CAST(x'ff' AS TEXT)", "views SET changed_at = CAST(x'ff' AS TEXT)"]
)
def test_a_row_with_invalid_text_does_not_affect_other_rows(data: Data, sql: str) -> None:
    data.change(f"UPDATE {sql}")
    assert data.codes() == {"row-unreadable"}
    data.repair()
    assert data.row("SELECT state FROM scans WHERE id = ?", REPLAY) == ("succeeded",)
    assert (data.root / "scans" / REPLAY / "model.json").exists()
    assert_lists_are_readable(data)


def test_a_finding_names_the_column_and_its_value(data: Data) -> None:
    data.change("UPDATE scans SET state = 'banana' WHERE id = ?", REPLAY)
    (finding,) = check_store(data.store).findings
    assert "state is 'banana': " in finding.what


def test_an_unreadable_scan_without_events_fails_and_its_result_is_moved_to_lost_and_found(data: Data) -> None:
    data.change("DELETE FROM events")
    data.change("UPDATE scans SET state = 'banana'")
    assert data.codes() == {"row-unreadable"}
    data.repair()
    for scan, recording in ((LIVE, LIVE), (REPLAY, UPLOAD)):
        state, failure, still = data.row("SELECT state, failure, recording FROM scans WHERE id = ?", scan)
        assert (state, json.loads(str(failure))["slug"], still) == ("failed", "damaged", recording)
    assert data.row("SELECT count(*) FROM views WHERE state = 'recorded'") == (4,)
    assert (data.lost(REPLAY) / "model.json").read_bytes() == b'{"chains": []}'
    assert_lists_are_readable(data)


def test_a_scan_that_cannot_be_repaired_is_moved_to_lost_and_found_with_its_result(data: Data) -> None:
    data.change("UPDATE scans SET request = 'banana' WHERE id = ?", REPLAY)
    assert data.codes() == {"row-unreadable"}
    data.repair()
    assert data.row("SELECT count(*) FROM scans") == (1,)
    assert data.original("SELECT request FROM scans WHERE id = ?", REPLAY) == ("banana",)
    assert (data.lost(REPLAY) / "model.json").read_bytes() == b'{"chains": []}'
    assert data.recording(UPLOAD).exists()
    assert data.row("SELECT count(*) FROM recordings") == (2,)
    assert_lists_are_readable(data)


@pytest.mark.parametrize(("column", "value"), [("state", "banana"), ("offset_bytes", "far"), ("reason", b"\xff")])
def test_an_unreadable_view_is_moved_to_lost_and_found_and_its_recording_stays(
    data: Data, column: str, value: object
) -> None:
    content = data.recording(LIVE).read_bytes()
    data.change(f"UPDATE views SET {column} = ? WHERE view = 2", value)
    assert data.codes() == {"row-unreadable"}
    data.repair()
    assert data.recording(LIVE).read_bytes() == content
    assert data.row("SELECT views FROM recordings WHERE id = ?", LIVE) == (4,)
    assert data.row("SELECT count(*) FROM views") == (3,)
    assert data.original("SELECT count(*) FROM views") == (4,)
    assert_lists_are_readable(data)


@pytest.mark.parametrize(("column", "value"), [("missing", "null"), ("provenance", "5"), ("views", "some")])
def test_an_unreadable_recording_is_adopted_again(data: Data, column: str, value: object) -> None:
    content = data.recording(UPLOAD).read_bytes()
    data.change(f"UPDATE recordings SET {column} = ? WHERE id = ?", value, UPLOAD)
    assert data.codes() == {"row-unreadable"}
    data.repair()
    assert data.row("SELECT views, missing FROM recordings WHERE id = ?", UPLOAD) == (4, "[]")
    assert data.row("SELECT recording FROM scans WHERE id = ?", REPLAY) == (UPLOAD,)
    assert data.recording(UPLOAD).read_bytes() == content


def test_an_unreadable_calibration_keeps_its_folder(data: Data) -> None:
    data.change("UPDATE calibrations SET state = 'banana'")
    assert data.codes() == {"row-unreadable"}
    data.repair()
    assert data.row("SELECT state FROM calibrations") == ("failed",)  # it has no result that would prove success
    assert (data.root / "calibration" / "runs" / "run-1" / "hand_eye.json").exists()
    assert_lists_are_readable(data)
    shutil.rmtree(data.root / "lost+found")
    data.change(
        "UPDATE calibrations SET kind = 'verification', state = 'banana', verification = ?, warnings = '[]'",
        json.dumps(VERIFICATION),
    )
    data.repair()
    assert data.row("SELECT state, verification FROM calibrations") == ("succeeded", json.dumps(VERIFICATION))
    data.change("INSERT INTO calibration_views VALUES ('run-1', 0, 'recorded', NULL, 40, 48, '', 0.1, '[7, 39]')")
    data.change("INSERT INTO calibration_views VALUES ('run-1', 1, 'banana', NULL, NULL, NULL, '', NULL, NULL)")
    data.change("INSERT INTO calibration_views VALUES ('run-1', 2, 'recorded', NULL, 40, 48, '', NULL, '[40]')")
    data.change("INSERT INTO calibration_views VALUES ('run-1', 3, 'recorded', NULL, 40, 48, '', 'near', '{')")
    assert data.codes() == {"row-unreadable"}
    shutil.rmtree(data.root / "lost+found")
    data.repair()
    assert_lists_are_readable(data)
    assert data.row("SELECT count(*), sum(cells = '[7, 39]') FROM calibration_views") == (1, 1)


# Read-only disk


@pytest.fixture
def read_only_disk(data: Data, tmp_path: Path) -> Iterator[Data]:
    """Yield the data folder on a disk that is mounted read-only."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder)],
            capture_output=True,
            text=True,
            check=False,
        )
    except FileNotFoundError:
        pytest.skip("the program mount is not installed")
    if done.returncode != 0:
        pytest.skip(f"only root can mount a file system: {done.stderr.strip()}")
    try:
        shutil.copytree(data.root, folder / "data")
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        yield Data(folder / "data", data.views)
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_read_only_disk_is_not_a_damaged_database(read_only_disk: Data) -> None:
    (finding,) = check_store(read_only_disk.store).findings
    assert (finding.code, finding.repairable) == ("database-inaccessible", False)
    assert "damaged" not in finding.what
    assert "read-only" in finding.what_to_do
    assert "--repair" not in finding.what_to_do


def test_a_database_that_cannot_be_opened_is_not_repaired(data: Data) -> None:
    """Put a folder in place of the log, so that it cannot be opened. This acts like missing permissions."""
    database = data.root / "pointchain.sqlite3"
    with closing(sqlite3.connect(database)) as db:
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    for suffix in ("-wal", "-shm"):
        database.with_name(database.name + suffix).unlink(missing_ok=True)
    database.with_name(database.name + "-wal").mkdir()
    before = database.read_bytes()
    assert data.codes() == {"database-inaccessible"}
    report = repair(check_target_of(data.root), pytest.fail)
    assert [finding.code for finding in report.findings] == ["database-inaccessible"]
    assert database.read_bytes() == before
    assert not (data.root / "lost+found").exists()
