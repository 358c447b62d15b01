"""A data folder with something of everything in it, and how to look at it, for tests that damage it."""

import dataclasses
import hashlib
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

from calibration.atomic_write import write_synced
from cell.recording.writer import RecordingWriter, read_recording
from service.integrity.check import Examined, examine
from service.integrity.repair import repair
from service.jobs.new_rows import NOBODY, new_calibration, new_scan
from service.processing.recording_metadata import describe_recording
from service.storage.calibration_store import CalibrationStore
from service.storage.data_folder import DataFolder
from service.storage.rows import ScanRow, ViewRow, insert
from service.storage.store import Store

LIVE, REPLAY, UPLOAD = "20260101t000000-000001-aaaaaaaa", "20260101t000000-000002-bbbbbbbb", "upload-1"


@dataclasses.dataclass(frozen=True)
class Data:
    """A data folder with a live scan of four views, an uploaded recording, and a replay of it with a result."""

    root: Path
    views: tuple[ViewRow, ...]

    @property
    def store(self) -> Examined:
        return examined(self.root)

    def recording(self, recording_id: str) -> Path:
        return self.root / "recordings" / f"{recording_id}.mcap"

    def codes(self, **how: bool) -> set[str]:
        """What is found."""
        return {finding.code for finding in examine(dataclasses.replace(self.store, **how)).findings}

    def mend(self) -> list[str]:
        """Repairs; the words, once nothing is left."""
        told: list[str] = []
        left = repair(self.store, told.append)
        assert left.findings == (), left.findings
        assert self.codes() == set()
        return told

    def row(self, sql: str, *values: object) -> tuple[object, ...]:
        with closing(sqlite3.connect(self.root / "pointchain.sqlite3")) as db:
            return db.execute(sql, values).fetchone()

    def change(self, sql: str, *values: object) -> None:
        with closing(sqlite3.connect(self.root / "pointchain.sqlite3")) as db, db:
            db.execute(sql, values)

    def lost(self, name: str) -> Path:
        """What was put aside under this name."""
        (found,) = self.root.glob(f"lost+found/*/{name}")
        return found


def examined(root: Path) -> Examined:
    """A data folder, its calibrations where they are unless configured, on a disk with space enough."""
    return Examined(root, root / "calibration" / "runs", 0)


def make_data(root: Path, recording_file: Path) -> Data:
    """All of it, in the new folder `root`."""
    folder = DataFolder(root)
    store = Store(folder)
    source = read_recording(recording_file)
    views = []
    with RecordingWriter(folder.recording(LIVE), source.header) as writer:
        for view in source.views:
            writer.write_view(view)
            piece = writer.written(view.index)
            place = (piece.offset_bytes, piece.size_bytes, piece.sha256)
            views.append(ViewRow(LIVE, view.index, "recorded", None, "2026-01-01T00:00:00Z", *place))
    live = dataclasses.replace(new_scan("live", "graph", None, NOBODY), id=LIVE, state="failed")
    store.add_scan(live)
    with store.database.transaction() as db:
        for view in views:
            insert(db, "views", view)
    store.add_scan_recording(describe_recording(LIVE, folder.recording(LIVE)))
    shutil.copy(recording_file, received := folder.incoming("upload"))
    store.add_recording(describe_recording(UPLOAD, received), received)
    add_result(store, dataclasses.replace(new_scan("replay", "graph", None, NOBODY, recording=UPLOAD), id=REPLAY))
    run = dataclasses.replace(new_calibration("calibration", None, 3), id="run-1", state="succeeded")
    CalibrationStore(store.database).add(run)
    (root / "calibration" / "runs" / "run-1").mkdir(parents=True)
    (root / "calibration" / "runs" / "run-1" / "hand_eye.json").write_text("{}")
    (root / "calibration" / "runs" / "2026-01-02_03-04-05").mkdir()  # made on the command line
    store.close()
    folder.close()
    return Data(root, tuple(views))


def add_result(store: Store, scan: ScanRow) -> None:
    store.add_scan(scan)
    results = store.folder.incoming(scan.id)
    results.mkdir()
    contents = {"model.json": b'{"chains": []}', "cloud.ply": b"ply\n"}
    for name, content in contents.items():
        write_synced(results / name, content)
    files = {
        name: {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
        for name, content in contents.items()
    }
    store.finish_scan(scan.id, "succeeded", {"chains": 0, "crossings": 0, "warnings": []}, results, files)
