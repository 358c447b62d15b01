"""Migration of a database of an earlier version by a made-up step, and databases that are refused."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from recognition.request import RecognitionRequest
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.database import Database, StoreVersionError
from service.storage.migrations import APPLICATION_ID, MIGRATIONS, latest_version
from service.storage.store import Store

COLOURS = """
CREATE TABLE colours (scan TEXT PRIMARY KEY, colour TEXT NOT NULL);
CREATE TRIGGER colours_stay BEFORE DELETE ON colours
    BEGIN SELECT RAISE(ABORT, 'a colour stays; it is never removed'); END;
INSERT INTO colours SELECT id, mode || ';red' FROM scans;
"""
"""A made-up step to the next version."""


def header(path: Path) -> tuple[int, int]:
    """Return the version of the tables and the application id."""
    with closing(sqlite3.connect(path)) as db:
        (version,) = db.execute("PRAGMA user_version").fetchone()
        (application_id,) = db.execute("PRAGMA application_id").fetchone()
    return version, application_id


def add_step(monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    monkeypatch.setattr("service.storage.migrations.MIGRATIONS", (*MIGRATIONS, step))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the file of a database of the present version with one scan."""
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        store.scans.add(new_scan("replay", RecognitionRequest(), NOBODY))
        return folder.database


def test_the_first_release_has_version_1(path: Path) -> None:
    assert latest_version() == 1
    assert header(path) == (1, APPLICATION_ID)


def test_a_database_of_an_earlier_version_is_migrated(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_step(monkeypatch, COLOURS)
    for _ in range(2):  # the second time nothing is left to do
        with closing(Database(path)) as database:
            assert database.all(tuple, "SELECT colour FROM colours") == [("replay;red",)]
            assert database.all(tuple, "SELECT count(*) FROM scans") == [(1,)]
        assert header(path) == (2, APPLICATION_ID)


def test_a_new_database_gets_the_tables_of_the_latest_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_step(monkeypatch, COLOURS)
    with closing(Database(tmp_path / "new.sqlite3")) as database:
        assert database.all(tuple, "SELECT colour FROM colours") == []
    assert header(tmp_path / "new.sqlite3") == (2, APPLICATION_ID)


def test_a_migration_that_fails_changes_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_step(monkeypatch, COLOURS + "INSERT INTO nowhere VALUES (1);")
    with pytest.raises(sqlite3.OperationalError, match="nowhere"):
        Database(path)
    assert header(path) == (1, APPLICATION_ID)
    with closing(sqlite3.connect(path)) as db:
        assert db.execute("SELECT count(*) FROM sqlite_master WHERE name = 'colours'").fetchone() == (0,)
        assert db.execute("SELECT count(*) FROM scans").fetchone() == (1,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("PRAGMA user_version = 99", r"tables of version 99, this software knows 1: use a later release"),
        ("PRAGMA application_id = 0", r"tables that no release of Pointchain made: use another data_dir"),
    ],
)
def test_a_database_of_another_version_is_refused_and_unchanged(path: Path, change: str, message: str) -> None:
    with closing(sqlite3.connect(path)) as db:
        db.execute(change)
    before = header(path)
    with pytest.raises(StoreVersionError, match=message):
        Database(path)
    assert header(path) == before


def test_a_database_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "pointchain.sqlite3"
    with closing(sqlite3.connect(path)) as db:
        db.execute("CREATE TABLE scans (id TEXT)")
    with pytest.raises(StoreVersionError, match="no release of Pointchain"):
        Database(path)
