"""Fault 21: power is lost during a write to the database, and its write-ahead log ends anywhere."""

import random
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

import pytest

from calibration.atomic_write import write_synced
from recognition.request import RecognitionRequest
from service.integrity.check import check_store
from service.integrity.repair import repair
from service.jobs.submission import Requester, new_scan
from service.processing.recording_metadata import describe_recording
from service.storage.data_folder import DATABASE, DataFolder
from service.storage.idempotency_keys import Key
from service.storage.store import Store
from tests.service.faults.recognition_stub import describe_here
from tests.service.stored_data import check_target_of

pytestmark = pytest.mark.fault(21)

Tables = dict[str, list[tuple[object, ...]]]
SCANS = 6
ALLOWED_FINDINGS = {
    "recording-without-row",
    "result-without-row",
    "scan-unfinished",
    "database-missing",
    "database-older",
}
"""Findings that a cut may cause: files without a row, an older database, and a scan without a final state."""


@dataclass(frozen=True)
class Written:
    """A data folder of a running service, and the content of its database after each commit."""

    root: Path
    commits: list[tuple[int, Tables]]
    """Size of the log after each commit, in bytes, and the rows of all tables."""

    def before(self, size_bytes: int) -> Tables:
        """Return the rows that are committed in the first `size_bytes` of the log."""
        return [rows for end, rows in self.commits if end <= size_bytes][-1]


def all_rows(database: Path) -> Tables:
    """Return all rows of a database, by table."""
    with closing(sqlite3.connect(database)) as db:
        names = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")]
        return {name: db.execute(f"SELECT * FROM {name} ORDER BY rowid").fetchall() for name in names}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, recording_file: Path) -> Iterator[Written]:
    """A data folder with some scans, whose log has not been checkpointed."""
    root = tmp_path_factory.mktemp("wal") / "data"
    folder = DataFolder(root)
    store = Store(folder)
    commits: list[tuple[int, Tables]] = []
    log = root / f"{DATABASE}-wal"

    def record_commit() -> None:
        commits.append((log.stat().st_size, all_rows(folder.database)))

    def commit(change: Callable[[], object]) -> None:
        change()
        record_commit()

    commits.append((0, {}))
    record_commit()
    for number in range(SCANS):
        requester = Requester("ann", Key("ann", f"key {number}", "hash"))
        row = new_scan("replay", RecognitionRequest(), requester)
        shutil.copy(recording_file, received := folder.incoming("received"))
        recording = describe_recording(row.id, received)
        commit(lambda received=received, recording=recording: store.add_recording(recording, received))
        scan = replace(row, recording=recording.id)
        commit(lambda scan=scan, requester=requester: store.scans.add(scan, requester.key_row(scan)))
        commit(lambda scan=scan: store.scans.set_view(scan.id, 0, "moving"))
        commit(lambda scan=scan: store.scans.update(scan.id, state="processing", stage="reading", fraction=0.5))
        if number == SCANS - 1:
            break
        results = folder.incoming(scan.id)
        results.mkdir()
        write_synced(results / "model.json", b"{}")
        files = {"model.json": {"sha256": "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a"}}
        files["model.json"]["size_bytes"] = 2  # type: ignore[assignment] (the stored form)
        write_synced(results / "cloud.ply", b"{}")
        files["cloud.ply"] = files["model.json"]
        commit(
            lambda scan=scan, results=results, files=files: store.scans.finish(scan.id, "succeeded", {}, results, files)
        )
    yield Written(root, commits)
    store.close()
    folder.close()


@dataclass(frozen=True)
class Damaged:
    """A copy of the database with a cut log that other bytes follow."""

    root: Path
    intact_bytes: int
    """Number of unchanged bytes of the log. Zeros after a cut can equal the original bytes."""


def damaged(written: Written, root: Path, cut: int, tail: bytes) -> Damaged:
    """Copy the database to `root`, cut its log at `cut` bytes and append `tail`."""
    root.mkdir()
    shutil.copy(written.root / DATABASE, root)
    log = (written.root / f"{DATABASE}-wal").read_bytes()
    (root / f"{DATABASE}-wal").write_bytes(log[:cut] + tail)
    equal = takewhile(lambda pair: pair[0] == pair[1], zip(log[cut:], tail, strict=False))
    return Damaged(root, cut + sum(1 for _ in equal))


def assert_has_commits_before_cut(written: Written, damaged: Damaged) -> None:
    """Assert that the database has each complete commit of the log and nothing of the next one."""
    with closing(sqlite3.connect(damaged.root / DATABASE)) as db:
        assert db.execute("PRAGMA quick_check").fetchall() == [("ok",)]
        assert db.execute("PRAGMA foreign_key_check").fetchall() == []
    rows = all_rows(damaged.root / DATABASE)
    assert rows == written.before(damaged.intact_bytes), f"intact up to {damaged.intact_bytes}"


@pytest.mark.parametrize("cuts", [20, pytest.param(500, marks=pytest.mark.soak)])
def test_a_cut_log_keeps_the_commits_before_the_cut(written: Written, tmp_path: Path, cuts: int) -> None:
    size, rng = written.commits[-1][0], random.Random(21)
    ends = [end for end, _ in written.commits[1:]]
    assert len(set(ends)) == len(ends), "the log was restarted, so its size does not identify a commit"
    cut_positions = [*rng.sample(ends, 4), *(rng.randrange(size + 1) for _ in range(cuts - 4))]
    for number, cut in enumerate(cut_positions):
        # After the synced part, a disk may have zeros or older data.
        tail = (b"", bytes(5000), rng.randbytes(5000))[number % 3]
        log_cut = damaged(written, tmp_path / f"{number}", cut, tail)
        assert_has_commits_before_cut(written, log_cut)
        shutil.rmtree(log_cut.root)


@pytest.mark.parametrize("cuts", [3, pytest.param(50, marks=pytest.mark.soak)])
def test_repair_and_the_store_continue_after_a_cut(
    written: Written, tmp_path: Path, cuts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.integrity.repair.describe_untrusted_recording", describe_here)
    size, rng = written.commits[-1][0], random.Random(22)
    for number in range(cuts):
        root = damaged(written, tmp_path / f"{number}", rng.randrange(size + 1), b"").root
        for name in ("recordings", "scans"):
            shutil.copytree(written.root / name, root / name)
        found = {finding.code for finding in check_store(check_target_of(root), running=False).findings}
        assert found <= ALLOWED_FINDINGS, found
        assert repair(check_target_of(root), lambda _: None).findings == ()
        with closing(DataFolder(root)) as folder, closing(Store(folder)) as opened:
            before = [row.id for row in opened.scans.newest(100)]
            scan = new_scan("replay", RecognitionRequest(), Requester())
            opened.scans.add(scan)
            assert [row.id for row in opened.scans.newest(100)] == [scan.id, *before]
