"""Fault 21: power is lost in the middle of a write to the database: its write-ahead log ends anywhere."""

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
from service.integrity.check import check_store
from service.integrity.repair import repair
from service.jobs.submission import Requester, new_scan
from service.processing.recording_metadata import describe_recording
from service.storage.data_folder import DATABASE, DataFolder
from service.storage.idempotency_keys import Key
from service.storage.store import Store
from tests.service.faults.pretended_recognition import describe_here
from tests.service.stored_data import check_target_of

pytestmark = pytest.mark.fault(21)

Told = dict[str, list[tuple[object, ...]]]
SCANS = 6
FOUND = {"recording-without-row", "result-without-row", "scan-unfinished", "database-missing", "database-older"}
"""What the doctor may find: what was on the disk before the database told of it, and what nobody has ended."""


@dataclass(frozen=True)
class Written:
    """A data folder as it is while a service is at work, and the whole of its database behind each commit."""

    root: Path
    commits: list[tuple[int, Told]]
    """How many bytes the log had behind it, and each table's rows."""

    def before(self, size_bytes: int) -> Told:
        """What was committed with so much of the log."""
        return [told for end, told in self.commits if end <= size_bytes][-1]


def told_by(database: Path) -> Told:
    """All rows, by table."""
    with closing(sqlite3.connect(database)) as db:
        names = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")]
        return {name: db.execute(f"SELECT * FROM {name} ORDER BY rowid").fetchall() for name in names}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory, recording_file: Path) -> Iterator[Written]:
    root = tmp_path_factory.mktemp("wal") / "data"
    folder = DataFolder(root)
    store = Store(folder)
    commits: list[tuple[int, Told]] = []
    log = root / f"{DATABASE}-wal"

    def note() -> None:
        commits.append((log.stat().st_size, told_by(folder.database)))

    def do(change: Callable[[], object]) -> None:
        change()
        note()

    commits.append((0, {}))
    note()
    for number in range(SCANS):
        asked = Requester("ann", Key("ann", f"key {number}", "hash"))
        row = new_scan("replay", "graph", None, asked)
        shutil.copy(recording_file, received := folder.incoming("received"))
        recording = describe_recording(row.id, received)
        do(lambda received=received, recording=recording: store.add_recording(recording, received))
        scan = replace(row, recording=recording.id)
        do(lambda scan=scan, asked=asked: store.scans.add(scan, asked.key_row(scan)))
        do(lambda scan=scan: store.scans.set_view(scan.id, 0, "moving"))
        do(lambda scan=scan: store.scans.update(scan.id, state="processing", stage="reading", fraction=0.5))
        if number == SCANS - 1:
            break
        results = folder.incoming(scan.id)
        results.mkdir()
        write_synced(results / "model.json", b"{}")
        files = {"model.json": {"sha256": "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a"}}
        files["model.json"]["size_bytes"] = 2  # type: ignore[assignment] (as it is kept)
        write_synced(results / "cloud.ply", b"{}")
        files["cloud.ply"] = files["model.json"]
        do(lambda scan=scan, results=results, files=files: store.scans.finish(scan.id, "succeeded", {}, results, files))
    yield Written(root, commits)
    store.close()
    folder.close()


@dataclass(frozen=True)
class Damaged:
    """A copy of the database whose log ends somewhere, with something else behind."""

    root: Path
    whole_bytes: int
    """So much of the log is as it was: zeros behind a cut may be what was there."""


def damaged(written: Written, root: Path, cut: int, behind: bytes) -> Damaged:
    """The log ends at `cut`, with something else `behind`."""
    root.mkdir()
    shutil.copy(written.root / DATABASE, root)
    log = (written.root / f"{DATABASE}-wal").read_bytes()
    (root / f"{DATABASE}-wal").write_bytes(log[:cut] + behind)
    alike = takewhile(lambda both: both[0] == both[1], zip(log[cut:], behind, strict=False))
    return Damaged(root, cut + sum(1 for _ in alike))


def is_a_prefix(written: Written, damaged: Damaged) -> None:
    """Each commit that is whole in the log is there, and of the next one nothing."""
    with closing(sqlite3.connect(damaged.root / DATABASE)) as db:
        assert db.execute("PRAGMA quick_check").fetchall() == [("ok",)]
        assert db.execute("PRAGMA foreign_key_check").fetchall() == []
    told = told_by(damaged.root / DATABASE)
    assert told == written.before(damaged.whole_bytes), f"whole up to {damaged.whole_bytes}"


@pytest.mark.parametrize("cuts", [20, pytest.param(500, marks=pytest.mark.soak)])
def test_cut_anywhere_it_tells_what_was_committed(written: Written, tmp_path: Path, cuts: int) -> None:
    size, chance = written.commits[-1][0], random.Random(21)
    ends = [end for end, _ in written.commits[1:]]
    assert len(set(ends)) == len(ends), "the log was begun anew: its size tells no commits apart"
    places = [*chance.sample(ends, 4), *(chance.randrange(size + 1) for _ in range(cuts - 4))]
    for number, cut in enumerate(places):
        # Behind what was synced a disk may have zeros, or what was there before.
        behind = (b"", bytes(5000), chance.randbytes(5000))[number % 3]
        log_cut = damaged(written, tmp_path / f"{number}", cut, behind)
        is_a_prefix(written, log_cut)
        shutil.rmtree(log_cut.root)


@pytest.mark.parametrize("cuts", [3, pytest.param(50, marks=pytest.mark.soak)])
def test_the_store_and_the_doctor_go_on_from_there(
    written: Written, tmp_path: Path, cuts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.integrity.repair.describe_untrusted_recording", describe_here)
    size, chance = written.commits[-1][0], random.Random(22)
    for number in range(cuts):
        root = damaged(written, tmp_path / f"{number}", chance.randrange(size + 1), b"").root
        for name in ("recordings", "scans"):
            shutil.copytree(written.root / name, root / name)
        found = {finding.code for finding in check_store(check_target_of(root), running=False).findings}
        assert found <= FOUND, found
        assert repair(check_target_of(root), lambda _: None).findings == ()
        with closing(DataFolder(root)) as folder, closing(Store(folder)) as opened:
            before = [row.id for row in opened.scans.newest(100)]
            scan = new_scan("replay", "graph", None, Requester())
            opened.scans.add(scan)
            assert [row.id for row in opened.scans.newest(100)] == [scan.id, *before]
