"""A data folder with one of each kind of data, and helpers that check and repair it, for tests that damage it."""

import dataclasses
import hashlib
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

from calibration.atomic_write import write_synced
from cell.recording import RecordingWriter, read_recording
from recognition.request import RecognitionRequest
from service.integrity.check import CheckTarget, check_store
from service.integrity.repair import repair
from service.jobs.submission import NOBODY, new_calibration, new_scan
from service.processing.recording_metadata import describe_recording
from service.storage.calibration_store import CalibrationStore
from service.storage.data_folder import DataFolder
from service.storage.rows import ScanRow, ViewRow, insert
from service.storage.store import Store

LIVE, REPLAY, UPLOAD = "20260101t000000-000001-aaaaaaaa", "20260101t000000-000002-bbbbbbbb", "upload-1"
SUMMARY = {"chains": 0, "crossings": 0, "verdict": "accept", "doubts": [], "doubt_count": 0, "note_count": 0}
"""Summary of the replay."""


@dataclasses.dataclass(frozen=True)
class Data:
    """A data folder with a live scan of four views, an uploaded recording, and a replay of it with a result."""

    root: Path
    views: tuple[ViewRow, ...]

    @property
    def store(self) -> CheckTarget:
        return check_target_of(self.root)

    def recording(self, recording_id: str) -> Path:
        return self.root / "recordings" / f"{recording_id}.mcap"

    def codes(self, **how: bool) -> set[str]:
        """Return the codes of all findings."""
        return {finding.code for finding in check_store(dataclasses.replace(self.store, **how)).findings}

    def repair(self) -> list[str]:
        """Repair everything, check that no finding remains, and return the messages."""
        messages: list[str] = []
        report = repair(self.store, messages.append)
        assert report.findings == (), report.findings
        assert self.codes() == set()
        return messages

    def row(self, sql: str, *values: object) -> tuple[object, ...]:
        with closing(sqlite3.connect(self.root / "pointchain.sqlite3")) as db:
            return db.execute(sql, values).fetchone()

    def original(self, sql: str, *values: object) -> tuple[object, ...]:
        """Return a row of the database as it was before the only repair."""
        with closing(sqlite3.connect(self.lost("pointchain.sqlite3"))) as db:
            return db.execute(sql, values).fetchone()

    def change(self, sql: str, *values: object) -> None:
        with closing(sqlite3.connect(self.root / "pointchain.sqlite3")) as db, db:
            db.execute(sql, values)

    def lost(self, name: str) -> Path:
        """Return the path in lost+found of the file or folder with this name."""
        (found,) = self.root.glob(f"lost+found/*/{name}")
        return found


def check_target_of(root: Path) -> CheckTarget:
    """Return a target for the check, with the default folder of calibrations and no need for free space."""
    return CheckTarget(root, root / "calibration" / "runs", 0)


def make_data(root: Path, recording_file: Path) -> Data:
    """Make a data folder with all kinds of data in the new folder `root`."""
    folder = DataFolder(root)
    store = Store(folder)
    source = read_recording(recording_file)
    views = []
    with RecordingWriter(folder.recording(LIVE), source.header) as writer:
        for view in source.views:
            writer.write_view(view)
            written = writer.written(view.index)
            values = (written.offset_bytes, written.size_bytes, written.sha256)
            views.append(ViewRow(LIVE, view.index, "recorded", None, "2026-01-01T00:00:00Z", *values))
    live = dataclasses.replace(new_scan("live", RecognitionRequest(), NOBODY), id=LIVE, state="failed")
    store.scans.add(live)
    with store.database.transaction() as db:
        for view in views:
            insert(db, "views", view)
    store.add_scan_recording(describe_recording(LIVE, folder.recording(LIVE)))
    shutil.copy(recording_file, received := folder.incoming("upload"))
    store.add_recording(describe_recording(UPLOAD, received), received)
    add_result(
        store, dataclasses.replace(new_scan("replay", RecognitionRequest(), NOBODY, recording=UPLOAD), id=REPLAY)
    )
    run = dataclasses.replace(new_calibration("calibration", None, 3), id="run-1", state="succeeded")
    CalibrationStore(store.database).add(run)
    (root / "calibration" / "runs" / "run-1").mkdir(parents=True)
    (root / "calibration" / "runs" / "run-1" / "hand_eye.json").write_text("{}")
    (root / "calibration" / "runs" / "2026-01-02_03-04-05").mkdir()  # made on the command line
    store.close()
    folder.close()
    return Data(root, tuple(views))


def add_result(store: Store, scan: ScanRow) -> None:
    store.scans.add(scan)
    results = store.folder.incoming(scan.id)
    results.mkdir()
    contents = {"model.json": b'{"chains": []}', "cloud.ply": b"ply\n"}
    for name, content in contents.items():
        write_synced(results / name, content)
    files = {
        name: {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
        for name, content in contents.items()
    }
    store.scans.finish(scan.id, "succeeded", SUMMARY, results, files)
