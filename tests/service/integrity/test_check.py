"""The integrity check finds each kind of damage to files. A repair leaves no finding and deletes no data."""

import dataclasses
import errno
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from recognition.request import RecognitionRequest
from service.cli.main import main
from service.integrity.check import CheckReport, check_store
from service.integrity.finding import GROUPS
from service.integrity.repair import repair
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder, DataFolderError
from service.storage.store import Store
from tests.service.stored_data import LIVE, REPLAY, UPLOAD, Data

SERVICE_UID = 4321
"""User id of a service that does not run as root."""


def flip_byte(path: Path, offset: int) -> None:
    content = bytearray(path.read_bytes())
    content[offset] ^= 0xFF
    path.write_bytes(content)


def test_a_complete_store_has_no_findings_and_the_check_changes_nothing(data: Data) -> None:
    before = {path: path.read_bytes() for path in data.root.rglob("*") if path.is_file()}
    found = check_store(data.store)
    assert (found.findings, found.service_runs) == ((), False)
    assert tuple(found.checked) == GROUPS
    after = {path: path.read_bytes() for path in data.root.rglob("*") if path.is_file()}
    # SQLite creates its shared memory file and leaves it; no other file is new
    assert {path: after[path] for path in before} == before
    assert {path.name for path in after.keys() - before.keys()} <= {
        "pointchain.sqlite3-shm",
        "pointchain.sqlite3-wal",
    }


# Recordings


def test_a_truncated_recording_keeps_its_complete_views(data: Data) -> None:
    path, last = data.recording(LIVE), data.views[-1]
    assert last.offset_bytes is not None
    content = path.read_bytes()[: last.offset_bytes + 100]
    path.write_bytes(content)
    assert data.codes() == {"recording-changed", "view-lost"}
    assert data.codes(quick=True) == {"recording-changed"}
    data.repair()
    assert path.read_bytes() == content  # the file stays as it is
    views, missing, sha256 = data.row("SELECT views, missing, sha256 FROM recordings WHERE id = ?", LIVE)
    assert (views, sha256) == (3, hashlib.sha256(content).hexdigest())
    assert "view 3 is missing" in str(missing)
    assert data.row("SELECT state FROM views WHERE scan = ? AND view = 3", LIVE) == ("missing",)
    assert data.row("SELECT state FROM views WHERE scan = ? AND view = 2", LIVE) == ("recorded",)


def test_damage_after_the_last_view_loses_no_view(data: Data) -> None:
    path = data.recording(LIVE)
    path.write_bytes(path.read_bytes()[:-5])
    found = check_store(data.store)
    (finding,) = found.findings
    assert finding.code == "recording-changed"
    assert "4 of 4 views are as they were acknowledged" in finding.what
    data.repair()
    assert data.row("SELECT views FROM recordings WHERE id = ?", LIVE) == (4,)


def test_an_unreadable_recording_is_moved_to_lost_and_found_with_its_row(data: Data) -> None:
    flip_byte(data.recording(UPLOAD), 3)
    content = data.recording(UPLOAD).read_bytes()
    assert data.codes() == {"recording-changed"}
    data.repair()
    assert data.lost("upload-1.mcap").read_bytes() == content
    assert data.original("SELECT views FROM recordings WHERE id = ?", UPLOAD) == (4,)
    assert "upload-1.mcap from" in data.lost("what-is-here.txt").read_text()
    assert data.row("SELECT recording, state FROM scans WHERE id = ?", REPLAY) == (None, "succeeded")


def test_the_row_of_a_missing_recording_is_removed(data: Data) -> None:
    data.recording(UPLOAD).unlink()
    assert data.codes(quick=True) == {"recording-missing"}
    data.repair()
    assert data.row("SELECT count(*) FROM recordings") == (1,)


def test_readable_recordings_without_a_row_are_adopted(data: Data, recording_file: Path) -> None:
    shutil.copy(recording_file, data.recording("found-1"))
    shutil.copy(recording_file, data.recording("20260102t030405-678901-0badcafe"))
    data.recording("found-2").write_bytes(b"nothing")
    shutil.copy(recording_file, data.recording("No-Id"))
    # the recording of a live scan, as if the service ended before it wrote the row
    data.change("UPDATE scans SET recording = NULL WHERE id = ?", LIVE)
    data.change("DELETE FROM recordings WHERE id = ?", LIVE)
    assert data.codes() == {"recording-without-row"}
    data.repair()
    assert data.row("SELECT views FROM recordings WHERE id = 'found-1'") == (4,)
    # its upload began at the time in its id
    created = "SELECT created_at FROM recordings WHERE id LIKE '%-0badcafe'"
    assert data.row(created) == ("2026-01-02T03:04:05.678Z",)
    assert data.row("SELECT recording FROM scans WHERE id = ?", LIVE) == (LIVE,)
    assert data.lost("found-2.mcap").read_bytes() == b"nothing"
    assert data.lost("No-Id.mcap").exists()


def test_a_scan_keeps_its_recording_if_the_row_of_the_recording_is_lost(data: Data) -> None:
    content = data.recording(UPLOAD).read_bytes()
    data.change("DELETE FROM recordings WHERE id = ?", UPLOAD)
    assert data.codes() == {"recording-without-row", "row-without-parent"}
    data.repair()
    assert data.row("SELECT views FROM recordings WHERE id = ?", UPLOAD) == (4,)
    assert data.row("SELECT recording FROM scans WHERE id = ?", REPLAY) == (UPLOAD,)
    assert data.recording(UPLOAD).read_bytes() == content


def test_a_scan_has_no_recording_if_its_file_and_row_are_lost(data: Data) -> None:
    data.change("DELETE FROM recordings WHERE id = ?", UPLOAD)
    data.recording(UPLOAD).unlink()
    data.repair()
    assert data.row("SELECT recording, state FROM scans WHERE id = ?", REPLAY) == (None, "succeeded")


def test_findings_describe_the_change_of_size_or_content(data: Data) -> None:
    size = data.recording(UPLOAD).stat().st_size
    flip_byte(data.recording(UPLOAD), size // 2)
    cloud = data.root / "scans" / REPLAY / "cloud.ply"
    cloud.write_bytes(b"ply\n\n")
    findings = {finding.code: finding for finding in check_store(data.store).findings}
    assert findings["recording-changed"].what == f"its content has changed, at the same size of {size} bytes"
    assert findings["result-changed"].what == "it has 5 bytes, and was written with 4"
    cloud.write_bytes(b"plx\n")
    data.recording(UPLOAD).write_bytes(b"x")
    findings = {finding.code: finding for finding in check_store(data.store).findings}
    assert findings["recording-changed"].what == f"it has 1 bytes, and was written with {size}"
    assert findings["result-changed"].what == "its content has changed, at the same size of 4 bytes"
    cloud.unlink()
    (missing,) = (finding for finding in check_store(data.store).findings if finding.code == "result-missing")
    assert "the rest of the result is moved to lost+found" in missing.what_to_do


# Results, calibrations, and unfinished work


@pytest.mark.parametrize("damage", ["missing", "longer", "flipped"])
def test_a_damaged_result_is_moved_to_lost_and_found_and_its_scan_fails(data: Data, damage: str) -> None:
    path = data.root / "scans" / REPLAY / "cloud.ply"
    {
        "missing": path.unlink,
        "longer": lambda: path.write_bytes(b"ply\n\n"),
        "flipped": lambda: flip_byte(path, 1),
    }[damage]()
    assert data.codes() == {"result-missing" if damage == "missing" else "result-changed"}
    assert bool(data.codes(quick=True)) == (damage != "flipped")
    data.repair()
    assert (data.lost(REPLAY) / "model.json").read_bytes() == b'{"chains": []}'
    state, failure = data.row("SELECT state, failure FROM scans WHERE id = ?", REPLAY)
    assert (state, json.loads(str(failure))["slug"]) == ("failed", "damaged")


def test_a_height_map_is_checked_if_the_result_has_one(data: Data) -> None:
    path = data.root / "scans" / REPLAY / "height-map.npz"
    assert data.codes() == set()  # a scan without a string has none
    files = json.loads(str(data.row("SELECT files FROM scans WHERE id = ?", REPLAY)[0]))
    files["height-map.npz"] = {"sha256": hashlib.sha256(b"map").hexdigest(), "size_bytes": 3}
    data.change("UPDATE scans SET files = ? WHERE id = ?", json.dumps(files), REPLAY)
    assert data.codes() == {"result-missing"}
    path.write_bytes(b"mop")
    assert data.codes() == {"result-changed"}
    path.write_bytes(b"map")
    assert data.codes() == set()


def test_a_link_is_called_a_link(data: Data, tmp_path: Path) -> None:
    for path in (data.root / "scans" / REPLAY / "cloud.ply", data.recording(UPLOAD)):
        path.rename(tmp_path / path.name)
        path.symlink_to(tmp_path / path.name)
    found = {finding.code: finding.what for finding in check_store(data.store).findings}
    assert found == dict.fromkeys(
        ("result-missing", "recording-missing"), "it is a symbolic link, which is not followed"
    )


@pytest.mark.parametrize("damage", ["missing", "longer", "flipped", "a link"])
def test_a_damaged_picture_is_moved_to_lost_and_found_and_its_result_stays(
    data: Data, tmp_path: Path, damage: str
) -> None:
    path = data.root / "scans" / REPLAY / "preview.png"
    path.write_bytes(b"png\n")
    assert data.codes() == set()  # no hash of it is recorded
    files = json.loads(str(data.row("SELECT files FROM scans WHERE id = ?", REPLAY)[0]))
    files["preview.png"] = {"sha256": hashlib.sha256(b"png\n").hexdigest(), "size_bytes": 4}
    data.change("UPDATE scans SET files = ? WHERE id = ?", json.dumps(files), REPLAY)
    assert data.codes() == set()
    {
        "missing": path.unlink,
        "longer": lambda: path.write_bytes(b"png\n\n"),
        "flipped": lambda: flip_byte(path, 1),
        "a link": lambda: path.rename(tmp_path / "png") and path.symlink_to(tmp_path / "png"),
    }[damage]()
    assert data.codes() == {"picture-changed"}
    assert bool(data.codes(quick=True)) == (damage != "flipped")
    data.repair()
    assert not os.path.lexists(path)
    assert data.row("SELECT state FROM scans WHERE id = ?", REPLAY) == ("succeeded",)
    left = json.loads(str(data.row("SELECT files FROM scans WHERE id = ?", REPLAY)[0]))
    assert left.keys() == {"model.json", "cloud.ply"}
    if damage != "missing":
        assert os.path.lexists(data.lost("preview.png"))


def test_a_result_of_an_older_version_has_no_hashes(data: Data) -> None:
    data.change("UPDATE scans SET files = NULL")
    flip_byte(data.root / "scans" / REPLAY / "cloud.ply", 1)
    assert data.codes() == set()
    (data.root / "scans" / REPLAY / "cloud.ply").unlink()
    assert data.codes() == {"result-missing"}


def test_files_without_a_row_are_moved_to_lost_and_found(data: Data) -> None:
    for path in ("scans/s9", "calibration/runs/run-9", "incoming/s9"):
        (data.root / path).mkdir(parents=True)
        (data.root / path / "model.json").write_text(path)
    assert data.codes() == {"result-without-row", "calibration-without-row", "leftover"}
    data.repair()
    kept = {path.read_text() for path in data.root.glob("lost+found/*/*/model.json")}
    assert kept == {"scans/s9", "calibration/runs/run-9", "incoming/s9"}
    assert (data.root / "calibration" / "runs" / "2026-01-02_03-04-05").exists()


def test_a_repair_first_copies_the_database(data: Data, monkeypatch: pytest.MonkeyPatch) -> None:
    (data.root / "incoming" / "s9").mkdir()
    data.change("UPDATE calibrations SET state = 'scanning'")
    database = data.root / "pointchain.sqlite3"
    before = database.read_bytes()

    def copy_half(source: Path, target: Path) -> None:
        target.write_bytes(source.read_bytes()[:100])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(shutil, "copy2", copy_half)
        with pytest.raises(OSError, match="No space"):
            repair(data.store, pytest.fail)
    assert database.read_bytes() == before
    assert list(data.root.glob("lost+found/*/*")) == []
    data.repair()
    assert data.lost("pointchain.sqlite3").read_bytes() == before


def test_unfinished_work_becomes_interrupted(data: Data) -> None:
    data.change("UPDATE scans SET state = 'processing' WHERE id = ?", REPLAY)
    data.change("UPDATE calibrations SET state = 'scanning'")
    # its result is in place already, but without the final state it is not valid
    assert data.codes() == {"scan-unfinished", "calibration-unfinished", "result-without-row"}
    data.repair()
    assert data.row("SELECT state FROM scans WHERE id = ?", REPLAY) == ("interrupted",)
    assert data.row("SELECT state FROM calibrations") == ("interrupted",)
    (kind, event) = data.row("SELECT kind, data FROM events WHERE scan = ? ORDER BY id DESC", REPLAY)
    assert (kind, json.loads(str(event))["state"]) == ("state", "interrupted")


def test_a_calibration_without_its_file_becomes_failed(data: Data) -> None:
    (data.root / "calibration" / "runs" / "run-1" / "hand_eye.json").unlink()
    assert data.codes() == {"calibration-missing"}
    data.repair()
    assert data.row("SELECT state FROM calibrations") == ("failed",)


# Service in use, tokens, disk and command line


def test_a_running_service_allows_a_check_but_no_repair(data: Data) -> None:
    folder = DataFolder(data.root)
    store = Store(folder)
    active_scan = new_scan("live", RecognitionRequest(), NOBODY)
    store.scans.add(active_scan)
    folder.recording(active_scan.id).write_bytes(b"being written")
    (folder.root / "incoming" / "upload").write_bytes(b"coming in")
    found = check_store(data.store)
    assert (found.findings, found.service_runs) == ((), True)
    with pytest.raises(DataFolderError, match="another service uses"):
        repair(data.store, pytest.fail)
    (data.root / "scans" / REPLAY / "model.json").unlink()
    assert data.codes() == {"result-missing"}
    store.close()
    folder.close()


@pytest.mark.parametrize("name", ["tokens.json", "sessions.json"])
def test_tokens_and_sessions_readable_by_other_users_are_restricted(data: Data, name: str) -> None:
    path = data.root / name
    path.write_text('{"schema_version": 1}')
    path.chmod(0o644)
    assert data.codes() == {"tokens-open"}
    data.repair()
    assert path.stat().st_mode & 0o777 == 0o600
    path.write_text("{")
    assert data.codes() == {"tokens-unreadable"}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
@pytest.mark.parametrize(
    ("owner", "mode", "found"),
    [
        (0, 0o600, {"tokens-unreadable"}),
        (SERVICE_UID, 0o000, {"tokens-unreadable"}),
        (SERVICE_UID, 0o600, set()),
        (0, 0o640, {"tokens-open"}),
    ],
    ids=["owned by root", "no permission", "owned by the service", "readable by the group"],
)
def test_root_finds_tokens_that_the_service_cannot_read(data: Data, owner: int, mode: int, found: set[str]) -> None:
    path = data.root / "tokens.json"
    path.write_text('{"schema_version": 1, "tokens": []}')
    path.chmod(mode)
    os.chown(path, owner, -1)
    os.chown(data.store.database, SERVICE_UID, -1)
    assert data.codes() == found


def test_little_free_space_is_a_finding(data: Data) -> None:
    found: CheckReport = check_store(dataclasses.replace(data.store, min_free_bytes=1 << 62))
    assert [finding.code for finding in found.findings] == ["little-space"]


def test_the_command_checks_and_repairs(
    data: Data, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("POINTCHAIN_LIMITS__MIN_FREE_BYTES", "0")
    run: Callable[..., int] = lambda *more: main(["doctor", "--data-dir", str(data.root), *more])  # noqa: E731
    assert run() == 0
    assert "No problem was found." in capsys.readouterr().out
    data.recording(UPLOAD).unlink()
    assert run("--quick") == 1
    printed = capsys.readouterr().out
    assert "failed   recordings" in printed
    assert "--repair" in printed
    assert run("--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert (document["healthy"], document["service_runs"]) == (False, False)
    assert [finding["code"] for finding in document["findings"]] == ["recording-missing"]
    assert run("--repair", "--json") == 0
    output = capsys.readouterr()
    document = json.loads(output.out)
    assert document["healthy"]
    assert len(document["repaired"]) == 1
    (copy,) = data.root.glob("lost+found/*/pointchain.sqlite3")
    assert str(copy) in output.err
    assert run("--data-dir", str(data.root / "none")) == 1
    (data.root / "unused").mkdir()
    capsys.readouterr()
    assert run("--data-dir", str(data.root / "unused")) == 0
    assert "no service has used this folder yet" in capsys.readouterr().out
