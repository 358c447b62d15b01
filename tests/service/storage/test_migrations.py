"""What earlier versions have stored, as this one reads it."""

import sqlite3
from contextlib import closing
from pathlib import Path

from service.storage.data_folder import DataFolder
from service.storage.migrations import MIGRATIONS
from service.storage.store import Store


def test_recordings_of_before_have_no_name_and_those_of_scans_have_their_time(tmp_path: Path) -> None:
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
