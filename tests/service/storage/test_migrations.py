"""Data of earlier versions, as this version reads them."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from service.api.server_sent_events import change_event
from service.errors import Failure
from service.storage.data_folder import DataFolder
from service.storage.migrations import MIGRATIONS
from service.storage.store import Store


def test_old_recordings_have_no_name_and_those_of_scans_have_their_time(tmp_path: Path) -> None:
    with closing(DataFolder(tmp_path)) as folder:
        with closing(sqlite3.connect(folder.database)) as db:
            for migration in MIGRATIONS[:5]:
                db.executescript(migration)
            columns = "id, created_at, size_bytes, sha256, views, missing, table_z_m, provenance"
            for name, ended in (("live", "08:55"), ("uploaded", "09:10")):
                row = (name, ended, 1, "ab", 8, "[]", 0.0, "{}")
                db.execute(f"INSERT INTO recordings ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)
            scan = ("live", "live", "live", "graph", "succeeded", 1.0, "08:54")
            columns = "id, recording, mode, method, state, fraction, created_at"
            db.execute(f"INSERT INTO scans ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)", scan)
            db.execute("PRAGMA user_version = 5")
            db.commit()
        with closing(Store(folder)) as store:
            live, uploaded = store.recording("live"), store.recording("uploaded")
            assert live is not None
            assert uploaded is not None
            assert [(one.created_at, one.name) for one in (live, uploaded)] == [("08:54", None), ("09:10", None)]


def test_problem_documents_of_version_6_become_failures(tmp_path: Path) -> None:
    problem = {"type": "urn:pointchain:robot-lost", "title": "Lost", "status": 503, "detail": "the link broke"}
    state = {"state": "failed", "stage": None, "fraction": 0.0, "summary": None}
    with closing(DataFolder(tmp_path)) as folder:
        with closing(sqlite3.connect(folder.database)) as db:
            for migration in MIGRATIONS[:6]:
                db.executescript(migration)
            columns = "id, mode, method, state, fraction, created_at, problem"
            sql = f"INSERT INTO scans ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)"
            for name, text in (("failed", json.dumps(problem)), ("succeeded", None), ("damaged", "{no json")):
                db.execute(sql, (name, "live", "graph", name, 0.0, "08:54", text))
            sql = "INSERT INTO events (scan, at, kind, data) VALUES ('failed', '08:54', 'state', ?)"
            for end in (None, problem | {"instance": "/api/scans/failed"}):
                db.execute(sql, (json.dumps(state | {"problem": end}),))
            db.execute("PRAGMA user_version = 6")
            db.commit()
        with closing(Store(folder)) as store:
            failed, succeeded = store.scan("failed"), store.scan("succeeded")
            assert failed is not None
            assert succeeded is not None
            assert (failed.failure, succeeded.failure) == (Failure("robot-lost", "the link broke"), None)
            with pytest.raises(json.JSONDecodeError):
                store.scan("damaged")  # as before; `pointchain doctor` finds it
            missed = store.events.since("failed", 0)
            assert missed is not None
            assert [event.data["failure"] for event in missed.events] == [
                None,
                {"slug": "robot-lost", "message": "the link broke"},
            ]
            assert b'"status": 503, "detail": "the link broke", "instance": "/api/scans/failed"' in change_event(
                missed.events[1]
            )
