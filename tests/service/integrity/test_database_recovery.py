"""A damaged database is kept, its readable rows are recovered, and recordings that lost their row are adopted."""

import dataclasses
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from recognition.request import RecognitionRequest
from service.integrity.database_check import TABLES
from service.integrity.database_recovery import recover_database
from service.integrity.repair import repair
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.database import now
from service.storage.migrations import MIGRATIONS, migrate
from service.storage.store import Store
from tests.service.stored_data import LIVE, REPLAY, UPLOAD, Data


def test_unreadable_rows_are_removed_and_stay_in_the_copy_of_the_database(data: Data) -> None:
    data.change("UPDATE recordings SET missing = '[not json' WHERE id = ?", UPLOAD)
    data.change("INSERT INTO views (scan, view, state, changed_at) VALUES ('nobody', 1, 'recorded', '')")
    data.change("UPDATE scans SET id = '../out' WHERE id = ?", LIVE)
    assert {"row-unreadable", "row-without-parent"} <= data.codes()
    messages = data.repair()
    assert any(message.startswith("views, ") and "removed: scan = 'nobody'" in message for message in messages)
    assert data.original("SELECT missing FROM recordings WHERE id = ?", UPLOAD) == ("[not json",)
    assert data.original("SELECT count(*) FROM views WHERE scan = 'nobody'") == (1,)
    assert data.original("SELECT count(*) FROM scans WHERE id = '../out'") == (1,)
    # the files of the recordings are intact, so they are adopted again
    assert data.row("SELECT count(*) FROM recordings") == (2,)


def test_a_damaged_database_is_kept_and_its_readable_rows_are_recovered(data: Data) -> None:
    folder = DataFolder(data.root)
    store = Store(folder)
    for _ in range(300):
        store.scans.add(
            dataclasses.replace(new_scan("replay", RecognitionRequest(), NOBODY, recording=UPLOAD), state="failed")
        )
    store.close()
    folder.close()
    database = data.root / "pointchain.sqlite3"
    content = bytearray(database.read_bytes())
    # a page in the middle of the rows of scans
    page = content.index(b"replay", len(content) // 3) // 4096 * 4096
    content[page : page + 4096] = random.Random(1).randbytes(4096)
    database.write_bytes(content)
    assert data.codes() == {"database-corrupt"}
    messages = data.repair()
    assert any("scans: " in message and "cannot be read" in message for message in messages)
    (scans,) = data.row("SELECT count(*) FROM scans")
    assert isinstance(scans, int)
    assert 200 < scans < 302  # the rows on the other pages
    assert data.lost("pointchain.sqlite3").read_bytes() == bytes(content)


def test_all_rows_outside_the_unreadable_parts_are_recovered(data: Data, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.integrity.database_recovery.MAX_GAP_ROWS", 1000)
    folder = DataFolder(data.root)
    store = Store(folder)
    scans = [new_scan("replay", RecognitionRequest(), NOBODY) for _ in range(300)]
    for scan in scans:
        store.scans.add(dataclasses.replace(scan, state="failed"))
    store.close()
    folder.close()
    database = data.root / "pointchain.sqlite3"
    content = database.read_bytes()
    pages = [content[start : start + 4096] for start in range(0, len(content), 4096)]
    leaves = [number for number, page in enumerate(pages) if b'replay{"method"' in page]
    damaged = {leaves[index] for index in (0, len(leaves) // 3, len(leaves) // 2, -1)}
    database.write_bytes(b"".join(bytes(4096) if n in damaged else page for n, page in enumerate(pages)))
    lost = b"".join(pages[number] for number in damaged)
    copy = data.root / "copy.sqlite3"
    shutil.copy(database, copy)
    recover_database(database, copy)
    with closing(sqlite3.connect(database)) as db:
        recovered = {row[0] for row in db.execute("SELECT id FROM scans")}
    assert len(damaged) == 4
    assert recovered >= {scan.id for scan in scans if scan.id.encode() not in lost}
    assert 100 < len(recovered) < 300


@pytest.mark.parametrize("content", [b"this is no database" * 500, None], ids=["another", "none"])
def test_without_a_database_the_recordings_are_adopted(data: Data, content: bytes | None) -> None:
    database = data.root / "pointchain.sqlite3"
    database.unlink() if content is None else database.write_bytes(content)
    data.repair()
    assert data.row("SELECT count(*) FROM recordings") == (2,)
    assert (data.lost(REPLAY) / "model.json").exists()


@pytest.mark.parametrize(
    ("change", "code"),
    [("PRAGMA user_version = 99", "database-newer"), ("PRAGMA application_id = 0", "database-unknown")],
)
def test_a_database_of_another_version_is_not_repaired(data: Data, change: str, code: str) -> None:
    data.change(change)
    assert data.codes() == {code}
    assert [finding.code for finding in repair(data.store, pytest.fail).findings] == [code]


@pytest.fixture
def next_version(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add a made-up version of the tables, in which a column of the audit log has another name."""
    step = "ALTER TABLE audit RENAME COLUMN who TO person;"
    monkeypatch.setattr("service.storage.migrations.MIGRATIONS", (*MIGRATIONS, step))


@pytest.mark.usefixtures("next_version")
def test_tables_of_an_earlier_version_are_migrated(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "pointchain.sqlite3")) as db:
        migrate(db, 1)
    data = Data(tmp_path, ())
    assert data.codes() == {"database-older"}
    data.repair()
    assert data.row("PRAGMA user_version") == (2,)


@pytest.mark.usefixtures("next_version")
def test_the_readable_rows_of_an_earlier_version_are_recovered_and_migrated(tmp_path: Path) -> None:
    database = tmp_path / "pointchain.sqlite3"
    with closing(sqlite3.connect(database)) as db, db:
        migrate(db, 1)
        entry = (now(), "Ada", "operator", "stop", "ready", 200)
        sql = "INSERT INTO audit (at, who, role, what, cell, status) VALUES (?, ?, ?, ?, ?, ?)"
        db.executemany(sql, [entry] * 300)
    content = bytearray(database.read_bytes())
    page = content.index(b"Ada", len(content) // 2) // 4096 * 4096  # in the middle of the rows
    content[page : page + 4096] = random.Random(1).randbytes(4096)
    database.write_bytes(content)
    data = Data(tmp_path, ())
    assert data.codes() == {"database-corrupt"}
    data.repair()
    assert data.row("PRAGMA user_version") == (2,)
    (entries,) = data.row("SELECT count(*) FROM audit WHERE person = 'Ada'")
    assert isinstance(entries, int)
    assert 150 < entries < 300  # the rows on the other pages


def test_a_truncated_log_keeps_the_first_transactions(data: Data, tmp_path: Path) -> None:
    """Truncate the log as a loss of power does. A kill alone loses nothing that was handed to the system."""
    folder = DataFolder(data.root)
    store = Store(folder)
    for number in range(30):
        store.scans.add(
            dataclasses.replace(new_scan("replay", RecognitionRequest(), NOBODY), id=f"s{number:02}", state="failed")
        )
    wal = (data.root / "pointchain.sqlite3-wal").read_bytes()
    before = (data.root / "pointchain.sqlite3").read_bytes()
    assert len(wal) > 30 * 4096
    for number in range(12):
        root = tmp_path / f"cut-{number}"
        root.mkdir()
        (root / "pointchain.sqlite3").write_bytes(before)
        (root / "pointchain.sqlite3-wal").write_bytes(wal[: random.Random(number).randrange(len(wal))])
        cut = dataclasses.replace(data, root=root)
        assert cut.codes() <= {"recording-missing", "result-missing", "calibration-missing"}
        with closing(sqlite3.connect(root / "pointchain.sqlite3")) as db:
            kept = [row[0] for row in db.execute("SELECT id FROM scans WHERE id LIKE 's__' ORDER BY id")]
            events = [row[0] for row in db.execute("SELECT scan FROM events WHERE scan LIKE 's__' ORDER BY scan")]
        assert kept == [f"s{k:02}" for k in range(len(kept))]
        assert events == kept  # each scan has the event of its transaction
    store.close()
    folder.close()


def test_every_table_is_recovered(data: Data) -> None:
    """Check that each table is among those that are copied, parents first."""
    with closing(sqlite3.connect(data.root / "pointchain.sqlite3")) as db:
        tables = {row[0] for row in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    assert set(TABLES) == tables - {"sqlite_sequence"}
    assert TABLES.index("recordings") < TABLES.index("scans") < TABLES.index("views")
