"""The store: rows and files after a restart and after a failure."""

import dataclasses
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from calibration.atomic_write import write_synced
from recognition.request import RecognitionRequest
from service.states import ACTIVE_STATES, ScanState
from service.storage.data_folder import DataFolder, DataFolderError
from service.storage.database import new_id
from service.storage.rows import RecordingRow, ScanRow
from service.storage.store import Store


def recording_row(recording_id: str = "r1") -> RecordingRow:
    return RecordingRow(
        id=recording_id,
        created_at="2026-01-02T03:04:05.678Z",
        size_bytes=3,
        sha256="ab",
        views=7,
        missing=["view 3 has no pose"],
        string_radius_m=None,
        table_z_m=-0.01,
        provenance={"camera": "oak, “new”"},
    )


def scan_row(scan_id: str = "s1", state: ScanState = "queued") -> ScanRow:
    return ScanRow(
        id=scan_id,
        mode="replay",
        recording="r1",
        request=RecognitionRequest("enhanced", 0.0042),
        state=state,
        stage=None,
        fraction=0.0,
        created_at="2026-01-02T03:04:05.678Z",
        started_at=None,
        ended_at=None,
        summary=None,
        failure=None,
    )


@contextmanager
def opened(root: Path) -> Iterator[Store]:
    folder = DataFolder(root)
    store = Store(folder)
    yield store
    store.close()
    folder.close()


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with opened(tmp_path / "data") as store:
        yield store


def add_recording(store: Store, recording_id: str = "r1") -> None:
    received = store.folder.incoming("upload")
    write_synced(received, b"abc")
    store.add_recording(recording_row(recording_id), received)


def test_rows_are_unchanged_after_a_restart(tmp_path: Path) -> None:
    with opened(tmp_path) as store:
        add_recording(store)
        store.scans.add(scan_row())
    with opened(tmp_path) as again:
        assert again.recording("r1") == recording_row()
        assert again.folder.recording("r1").read_bytes() == b"abc"
        assert again.scans.get("s1") == scan_row()
        assert again.recording("s1") is None
        assert again.scans.get("r1") is None


def test_a_finished_scan_has_its_files_and_a_summary(store: Store) -> None:
    add_recording(store)
    store.scans.add(scan_row())
    results = store.folder.incoming("s1")
    results.mkdir()
    write_synced(results / "model.json", b"{}")
    store.scans.finish("s1", "partial", {"chains": 1}, results)
    scan = store.scans.get("s1")
    assert scan is not None
    assert (scan.state, scan.summary, scan.fraction) == ("partial", {"chains": 1}, 1.0)
    assert (store.folder.results("s1") / "model.json").read_bytes() == b"{}"
    assert not results.exists()


def test_a_final_state_cannot_be_changed(store: Store) -> None:
    add_recording(store)
    store.scans.add(scan_row())
    assert store.scans.update("s1", state="aborted")
    assert not store.scans.update("s1", state="succeeded")
    scan = store.scans.get("s1")
    assert scan is not None
    assert scan.state == "aborted"


@pytest.mark.parametrize("state", ACTIVE_STATES)
def test_unfinished_scans_become_interrupted_and_lose_results_without_a_row(store: Store, state: ScanState) -> None:
    add_recording(store)
    store.scans.add(scan_row("s1", state))
    store.scans.add(scan_row("s2", "succeeded"))
    for scan_id in ("s1", "s2"):
        store.folder.results(scan_id).mkdir()
    store.scans.interrupt_unfinished("~")
    interrupted, done = store.scans.get("s1"), store.scans.get("s2")
    assert interrupted is not None
    assert interrupted.state == "interrupted"
    assert interrupted.failure is not None
    assert interrupted.failure.slug == "interrupted"
    assert done == scan_row("s2", "succeeded")
    assert not store.folder.results("s1").exists()
    assert store.folder.results("s2").exists()


def test_a_recording_whose_row_cannot_be_written_leaves_no_file(store: Store) -> None:
    received = store.folder.incoming("upload")
    write_synced(received, b"abc")
    with pytest.raises(sqlite3.IntegrityError):
        store.add_recording(dataclasses.replace(recording_row(), sha256=None), received)  # type: ignore[arg-type] (the database must refuse it, not the type checker)
    assert store.recording("r1") is None
    assert not store.folder.recording("r1").exists()


def test_lists_have_pages_with_the_newest_first(store: Store) -> None:
    ids = sorted(new_id() for _ in range(5))
    for scan_id in ids:
        add_recording(store, scan_id)
        store.scans.add(dataclasses.replace(scan_row(scan_id), recording=scan_id))
    assert [row.id for row in store.scans.newest(3, None)] == ids[:1:-1]
    assert [row.id for row in store.scans.newest(3, ids[2])] == ids[1::-1]
    assert [row.id for row in store.recordings(2, ids[4])] == ids[3:1:-1]


def test_threads_write_concurrently(store: Store) -> None:
    add_recording(store)
    threads = [
        threading.Thread(target=lambda n=n: [store.scans.add(scan_row(f"s{n}-{k}")) for k in range(20)])
        for n in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(store.scans.newest(500, None)) == 160


def test_commits_are_synced(store: Store) -> None:
    with store.database.connection() as db:
        assert db.execute("PRAGMA journal_mode").fetchone()[0] == "wal"
        assert db.execute("PRAGMA synchronous").fetchone()[0] == 2  # FULL


def test_ids_sort_by_time_and_are_plain_names() -> None:
    ids = [new_id() for _ in range(1000)]
    assert len(set(ids)) == 1000
    assert [i[:22] for i in ids] == sorted(i[:22] for i in ids)
    assert all(set(i) <= set("0123456789abcdef-t") for i in ids)


def test_a_data_folder_has_one_service(store: Store) -> None:
    with pytest.raises(DataFolderError, match="another service uses"):
        DataFolder(store.folder.root)


def test_a_folder_that_cannot_be_created_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DataFolderError, match="set data_dir"):
        DataFolder(tmp_path / "file" / "data")


def test_incomplete_incoming_files_are_removed(tmp_path: Path) -> None:
    (tmp_path / "incoming" / "s1").mkdir(parents=True)
    (tmp_path / "incoming" / "s1" / "model.json").write_text("{")
    folder = DataFolder(tmp_path)
    assert list((tmp_path / "incoming").iterdir()) == []
    folder.close()
