"""The doctor finds each kind of damage to files, mends what can be, and finds nothing then; what held data is still
there."""

import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from service.cli.main import main
from service.integrity.check import Examination, examine
from service.integrity.finding import GROUPS
from service.integrity.repair import repair
from service.jobs.new_rows import NOBODY, new_scan
from service.storage.data_folder import DataFolder, DataFolderError
from service.storage.store import Store
from tests.service.stored_data import LIVE, REPLAY, UPLOAD, Data

SERVICE_UID = 4321
"""User id of a service that does not run as root."""


def flip(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 0xFF
    path.write_bytes(content)


def test_a_whole_store_is_well_and_looking_changes_nothing(data: Data) -> None:
    before = {path: path.read_bytes() for path in data.root.rglob("*") if path.is_file()}
    found = examine(data.store)
    assert (found.findings, found.service_runs) == ((), False)
    assert tuple(found.looked_at) == GROUPS
    after = {path: path.read_bytes() for path in data.root.rglob("*") if path.is_file()}
    # SQLite makes and leaves its shared memory; nothing else is there, or another.
    assert {path: after[path] for path in before} == before
    assert {path.name for path in after.keys() - before.keys()} <= {
        "pointchain.sqlite3-shm",
        "pointchain.sqlite3-wal",
    }


# Recordings


def test_a_recording_cut_short_keeps_the_views_that_are_there(data: Data) -> None:
    path, last = data.recording(LIVE), data.views[-1]
    assert last.offset_bytes is not None
    content = path.read_bytes()[: last.offset_bytes + 100]
    path.write_bytes(content)
    assert data.codes() == {"recording-changed", "view-lost"}
    assert data.codes(quick=True) == {"recording-changed"}
    data.mend()
    assert path.read_bytes() == content  # the file stays as it is
    views, missing, sha256 = data.row("SELECT views, missing, sha256 FROM recordings WHERE id = ?", LIVE)
    assert (views, sha256) == (3, hashlib.sha256(content).hexdigest())
    assert "view 3 is missing" in str(missing)
    assert data.row("SELECT state FROM views WHERE scan = ? AND view = 3", LIVE) == ("missing",)
    assert data.row("SELECT state FROM views WHERE scan = ? AND view = 2", LIVE) == ("recorded",)


def test_damage_behind_the_views_loses_none(data: Data) -> None:
    path = data.recording(LIVE)
    path.write_bytes(path.read_bytes()[:-5])
    found = examine(data.store)
    (finding,) = found.findings
    assert finding.code == "recording-changed"
    assert "4 of 4 views are as they were acknowledged" in finding.what
    data.mend()
    assert data.row("SELECT views FROM recordings WHERE id = ?", LIVE) == (4,)


def test_a_recording_that_cannot_be_read_is_put_aside_with_its_row(data: Data) -> None:
    flip(data.recording(UPLOAD), 3)
    content = data.recording(UPLOAD).read_bytes()
    assert data.codes() == {"recording-changed"}
    data.mend()
    assert data.lost("upload-1.mcap").read_bytes() == content
    row = json.loads(data.lost("rows.jsonl").read_text())
    assert (row["table"], row["row"]["id"]) == ("recordings", UPLOAD)
    assert "upload-1.mcap from" in data.lost("what-is-here.txt").read_text()
    assert data.row("SELECT recording, state FROM scans WHERE id = ?", REPLAY) == (None, "succeeded")


def test_a_recording_that_is_gone_is_no_longer_told(data: Data) -> None:
    data.recording(UPLOAD).unlink()
    assert data.codes(quick=True) == {"recording-missing"}
    data.mend()
    assert data.row("SELECT count(*) FROM recordings") == (1,)


def test_recordings_without_a_row_are_taken_in_if_they_can_be_read(data: Data, recording_file: Path) -> None:
    shutil.copy(recording_file, data.recording("found-1"))
    data.recording("found-2").write_bytes(b"nothing")
    shutil.copy(recording_file, data.recording("No-Id"))
    # A live scan's, whose row the service had no time to write.
    data.change("UPDATE scans SET recording = NULL WHERE id = ?", LIVE)
    data.change("DELETE FROM recordings WHERE id = ?", LIVE)
    assert data.codes() == {"recording-without-row"}
    data.mend()
    assert data.row("SELECT views FROM recordings WHERE id = 'found-1'") == (4,)
    assert data.row("SELECT recording FROM scans WHERE id = ?", LIVE) == (LIVE,)
    assert data.lost("found-2.mcap").read_bytes() == b"nothing"
    assert data.lost("No-Id.mcap").exists()


def test_a_scan_keeps_its_recording_when_that_has_lost_its_row(data: Data) -> None:
    content = data.recording(UPLOAD).read_bytes()
    data.change("DELETE FROM recordings WHERE id = ?", UPLOAD)
    assert data.codes() == {"recording-without-row", "row-without-parent"}
    data.mend()
    assert data.row("SELECT views FROM recordings WHERE id = ?", UPLOAD) == (4,)
    assert data.row("SELECT recording FROM scans WHERE id = ?", REPLAY) == (UPLOAD,)
    assert data.recording(UPLOAD).read_bytes() == content


def test_a_scan_has_no_recording_when_file_and_row_are_gone(data: Data) -> None:
    data.change("DELETE FROM recordings WHERE id = ?", UPLOAD)
    data.recording(UPLOAD).unlink()
    data.mend()
    assert data.row("SELECT recording, state FROM scans WHERE id = ?", REPLAY) == (None, "succeeded")


def test_what_has_changed_is_told_as_it_is(data: Data) -> None:
    size = data.recording(UPLOAD).stat().st_size
    flip(data.recording(UPLOAD), size // 2)
    cloud = data.root / "scans" / REPLAY / "cloud.ply"
    cloud.write_bytes(b"ply\n\n")
    told = {finding.code: finding for finding in examine(data.store).findings}
    assert told["recording-changed"].what == f"its content has changed, at the same size of {size} bytes"
    assert told["result-changed"].what == "it has 5 bytes, and was written with 4"
    cloud.write_bytes(b"plx\n")
    data.recording(UPLOAD).write_bytes(b"x")
    told = {finding.code: finding for finding in examine(data.store).findings}
    assert told["recording-changed"].what == f"it has 1 bytes, and was written with {size}"
    assert told["result-changed"].what == "its content has changed, at the same size of 4 bytes"
    cloud.unlink()
    (missing,) = (finding for finding in examine(data.store).findings if finding.code == "result-missing")
    assert "what there is of the result is put aside" in missing.what_to_do


# Results, calibrations, and what was under way


@pytest.mark.parametrize("damage", ["gone", "longer", "other"])
def test_a_damaged_result_is_put_aside_and_its_scan_failed(data: Data, damage: str) -> None:
    path = data.root / "scans" / REPLAY / "cloud.ply"
    {"gone": path.unlink, "longer": lambda: path.write_bytes(b"ply\n\n"), "other": lambda: flip(path, 1)}[damage]()
    assert data.codes() == {"result-missing" if damage == "gone" else "result-changed"}
    assert bool(data.codes(quick=True)) == (damage != "other")
    data.mend()
    assert (data.lost(REPLAY) / "model.json").read_bytes() == b'{"chains": []}'
    state, failure = data.row("SELECT state, failure FROM scans WHERE id = ?", REPLAY)
    assert (state, json.loads(str(failure))["slug"]) == ("failed", "damaged")


def test_a_result_of_an_older_version_has_no_hashes(data: Data) -> None:
    data.change("UPDATE scans SET files = NULL")
    flip(data.root / "scans" / REPLAY / "cloud.ply", 1)
    assert data.codes() == set()
    (data.root / "scans" / REPLAY / "cloud.ply").unlink()
    assert data.codes() == {"result-missing"}


def test_what_nothing_tells_of_is_put_aside(data: Data) -> None:
    for path in ("scans/s9", "calibration/runs/run-9", "incoming/s9"):
        (data.root / path).mkdir(parents=True)
        (data.root / path / "model.json").write_text(path)
    assert data.codes() == {"result-without-row", "calibration-without-row", "leftover"}
    data.mend()
    kept = {path.read_text() for path in data.root.glob("lost+found/*/*/model.json")}
    assert kept == {"scans/s9", "calibration/runs/run-9", "incoming/s9"}
    assert (data.root / "calibration" / "runs" / "2026-01-02_03-04-05").exists()


def test_what_a_service_left_unfinished_is_interrupted(data: Data) -> None:
    data.change("UPDATE scans SET state = 'processing' WHERE id = ?", REPLAY)
    data.change("UPDATE calibrations SET state = 'scanning'")
    # Its results were in place already, but do not count.
    assert data.codes() == {"scan-unfinished", "calibration-unfinished", "result-without-row"}
    data.mend()
    assert data.row("SELECT state FROM scans WHERE id = ?", REPLAY) == ("interrupted",)
    assert data.row("SELECT state FROM calibrations") == ("interrupted",)
    (kind, told) = data.row("SELECT kind, data FROM events WHERE scan = ? ORDER BY id DESC", REPLAY)
    assert (kind, json.loads(str(told))["state"]) == ("state", "interrupted")


def test_a_calibration_without_its_file_is_failed(data: Data) -> None:
    (data.root / "calibration" / "runs" / "run-1" / "hand_eye.json").unlink()
    assert data.codes() == {"calibration-missing"}
    data.mend()
    assert data.row("SELECT state FROM calibrations") == ("failed",)


# The rest


def test_a_service_that_runs_may_be_looked_at_but_not_mended(data: Data) -> None:
    folder = DataFolder(data.root)
    store = Store(folder)
    under_way = new_scan("live", "graph", None, NOBODY)
    store.add_scan(under_way)
    folder.recording(under_way.id).write_bytes(b"being written")
    (folder.root / "incoming" / "upload").write_bytes(b"coming in")
    found = examine(data.store)
    assert (found.findings, found.service_runs) == ((), True)
    with pytest.raises(DataFolderError, match="another service uses"):
        repair(data.store, pytest.fail)
    (data.root / "scans" / REPLAY / "model.json").unlink()
    assert data.codes() == {"result-missing"}
    store.close()
    folder.close()


def test_tokens_that_others_may_read_are_closed(data: Data) -> None:
    path = data.root / "tokens.json"
    path.write_text('{"schema_version": 1, "tokens": []}')
    path.chmod(0o644)
    assert data.codes() == {"tokens-open"}
    data.mend()
    assert path.stat().st_mode & 0o777 == 0o600
    path.write_text("{")
    assert data.codes() == {"tokens-unreadable"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file to another user")
@pytest.mark.parametrize(
    ("owner", "mode", "found"),
    [
        (0, 0o600, {"tokens-unreadable"}),
        (SERVICE_UID, 0o000, {"tokens-unreadable"}),
        (SERVICE_UID, 0o600, set()),
        (0, 0o640, {"tokens-open"}),
    ],
    ids=["of root", "of nobody", "its own", "of its group"],
)
def test_tokens_that_the_service_cannot_read_are_found_by_root_too(
    data: Data, owner: int, mode: int, found: set[str]
) -> None:
    path = data.root / "tokens.json"
    path.write_text('{"schema_version": 1, "tokens": []}')
    path.chmod(mode)
    os.chown(path, owner, -1)
    os.chown(data.store.database, SERVICE_UID, -1)
    assert data.codes() == found


def test_little_space_is_told(data: Data) -> None:
    found: Examination = examine(dataclasses.replace(data.store, min_free_bytes=1 << 62))
    assert [finding.code for finding in found.findings] == ["little-space"]


def test_on_the_command_line(data: Data, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("POINTCHAIN_LIMITS__MIN_FREE_BYTES", "0")
    run: Callable[..., int] = lambda *more: main(["doctor", "--data-dir", str(data.root), *more])  # noqa: E731 (three words)
    assert run() == 0
    assert "The store is well." in capsys.readouterr().out
    data.recording(UPLOAD).unlink()
    assert run("--quick") == 1
    told = capsys.readouterr().out
    assert "failed   recordings" in told
    assert "--repair" in told
    assert run("--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["well"], document["service_runs"]) == (False, False)
    assert [finding["code"] for finding in document["findings"]] == ["recording-missing"]
    assert run("--repair", "--json") == 0
    output = capsys.readouterr()
    document = json.loads(output.out)
    assert document["well"]
    assert len(document["repaired"]) == 1
    assert "rows.jsonl" in output.err
    assert run("--data-dir", str(data.root / "none")) == 1
    (data.root / "unused").mkdir()
    capsys.readouterr()
    assert run("--data-dir", str(data.root / "unused")) == 0
    assert "no service has used this folder yet" in capsys.readouterr().out
