"""Migrations of data of earlier versions."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from service.api.schemas.calibration_resources import run_resource
from service.api.schemas.scan_resource import scan_resource
from service.api.server_sent_events import change_event
from service.errors import Failure
from service.jobs.calibration_activation import why_not_activatable
from service.processing.results import MAX_SUMMARY_DOUBTS
from service.storage.data_folder import DataFolder
from service.storage.database import migrate
from service.storage.store import Store


@contextmanager
def database_of_version(version: int, folder: DataFolder) -> Iterator[sqlite3.Connection]:
    """Yield a new database with the tables of a version. What the block writes is committed at its end."""
    with closing(sqlite3.connect(folder.database)) as db, db:
        migrate(db, version)
        yield db


def test_recordings_of_version_5_get_no_name_and_the_time_of_their_scan(tmp_path: Path) -> None:
    with closing(DataFolder(tmp_path)) as folder:
        with database_of_version(5, folder) as db:
            columns = "id, created_at, size_bytes, sha256, views, missing, table_z_m, provenance"
            for name, ended in (("live", "08:55"), ("uploaded", "09:10")):
                row = (name, ended, 1, "ab", 8, "[]", 0.0, "{}")
                db.execute(f"INSERT INTO recordings ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)", row)
            scan = ("live", "live", "live", "graph", "succeeded", 1.0, "08:54")
            columns = "id, recording, mode, method, state, fraction, created_at"
            db.execute(f"INSERT INTO scans ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)", scan)
        with closing(Store(folder)) as store:
            live, uploaded = store.recording("live"), store.recording("uploaded")
            assert live is not None
            assert uploaded is not None
            assert [(one.created_at, one.name) for one in (live, uploaded)] == [("08:54", None), ("09:10", None)]


def test_problem_documents_of_version_6_become_failures(tmp_path: Path) -> None:
    problem = {"type": "urn:pointchain:robot-lost", "title": "Lost", "status": 503, "detail": "the link broke"}
    state = {"state": "failed", "stage": None, "fraction": 0.0, "summary": None}
    with closing(DataFolder(tmp_path)) as folder:
        with database_of_version(6, folder) as db:
            columns = "id, mode, method, state, fraction, created_at, problem"
            sql = f"INSERT INTO scans ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)"
            for name, text in (("failed", json.dumps(problem)), ("succeeded", None), ("damaged", "{no json")):
                db.execute(sql, (name, "live", "graph", name, 0.0, "08:54", text))
            sql = "INSERT INTO events (scan, at, kind, data) VALUES ('failed', '08:54', 'state', ?)"
            for end in (None, problem | {"instance": "/api/scans/failed"}):
                db.execute(sql, (json.dumps(state | {"problem": end}),))
        with closing(Store(folder)) as store:
            failed, succeeded = store.scans.get("failed"), store.scans.get("succeeded")
            assert failed is not None
            assert succeeded is not None
            assert (failed.failure, succeeded.failure) == (Failure("robot-lost", "the link broke"), None)
            with pytest.raises(json.JSONDecodeError):
                store.scans.get("damaged")  # the damage is kept; `pointchain doctor` finds it
            missed = store.events.since("failed", 0)
            assert missed is not None
            assert [event.data["failure"] for event in missed.events] == [
                None,
                {"slug": "robot-lost", "message": "the link broke"},
            ]
            assert b'"status": 503, "detail": "the link broke", "instance": "/api/scans/failed"' in change_event(
                missed.events[1]
            )


VERIFICATION_7 = {
    "passed": True, "words": 'the board was "moved":  \\"words": by 9 mm', "worst_m": 0.009, "expected_m": 0.001,
    "worst_rad": 0.002, "expected_rad": 0.001, "board_moved_m": 0.009, "board_turned_rad": 0.002,
    "views": [{"name": "a", "off_m": 0.009, "off_rad": 0.002, "expected_m": 0.001, "expected_rad": 0.001}],
}  # fmt: skip
RESULT_7 = {
    "schema_version": 1,
    "verdict": "refuse",
    "findings": [{"code": "leave-one-out", "words": "views disagree", "refuses": True}],
    "T_flange_camera": None,
    "T_base_board": None,
    "covariance": {"matrix": [[None] * 6] * 6, "order": [], "side": "right", "units": []},
    "intrinsics": {"K": [[1.0]], "K_told": [[2.0]]},
    "board": {"kind": "charuco"},
    "metrics": {
        "sigma_m": None, "sigma_rad": None, "eight_views_m": 0.003, "left_out_m": 0.001, "pixel_sigma_px": None,
        "robot_sigma_m": None, "robot_sigma_rad": None, "views_given": 1, "views_used": 1,
    },
    "views": [{
        "name": "a", "used": True, "reason": None, "corners": 40, "rms_px": 0.1, "robot_error_m": None,
        "robot_error_rad": None, "left_out_m": 0.002, "distance_m": 0.4,
    }],
    "verification": VERIFICATION_7,
}  # fmt: skip


def test_calibrations_of_version_7_get_the_present_names(tmp_path: Path) -> None:
    with closing(DataFolder(tmp_path)) as folder:
        with database_of_version(7, folder) as db:
            columns = "id, kind, poses, warnings, state, fraction, coverage, created_at, result, verification"
            sql = f"INSERT INTO calibrations ({columns}) VALUES (?, ?, 15, '[]', ?, 1.0, 1.0, '08:54', ?, ?)"
            solved, verified = json.dumps(RESULT_7), json.dumps(VERIFICATION_7)
            db.execute(sql, ("solved", "calibration", "succeeded", solved, verified))
            db.execute(sql, ("failed", "calibration", "failed", None, None))
            db.execute(sql, ("damaged", "calibration", "succeeded", "{no json", None))
            columns = "calibration, view, state, corners, possible, changed_at"
            db.execute(f"INSERT INTO calibration_views ({columns}) VALUES ('solved', 0, 'recorded', 40, 48, '08:54')")
            columns = "id, mode, method, state, fraction, created_at, asked_by"
            db.execute(f"INSERT INTO scans ({columns}) VALUES ('scan', 'live', 'graph', 'failed', 0.0, '08:54', 'Ada')")
        with closing(Store(folder)) as store:
            scan, solved, failed = (
                store.scans.get("scan"),
                store.calibrations.get("solved"),
                store.calibrations.get("failed"),
            )
            assert scan is not None
            assert scan.requested_by == "Ada"
            assert failed is not None
            assert (failed.result, failed.verification) == (None, None)
            with pytest.raises(json.JSONDecodeError):
                store.calibrations.get("damaged")
            assert solved is not None
            views = store.calibrations.views(["solved"])
    assert solved.result is not None
    assert solved.result["schema_version"] == 2
    assert solved.result["covariance"]["convention"] == "right"
    assert solved.result["intrinsics"] == {"K": [[1.0]], "K_given": [[2.0]]}
    assert solved.result["verification"] == solved.verification
    refusal = why_not_activatable(solved)
    assert refusal is not None
    assert str(refusal) == "the result of calibration solved must not be used: views disagree"
    run = run_resource(solved, views)
    assert run.result is not None
    assert (run.result.metrics.repeatability_95_m, run.result.metrics.loo_error_m) == (0.003, 0.001)
    assert (run.result.views[0].loo_error_m, run.result.findings[0].blocking) == (0.002, True)
    assert run.verification is not None
    assert run.verification.message == VERIFICATION_7["words"]
    assert (run.verification.max_deviation_m, run.verification.max_deviation_rad) == (0.009, 0.002)
    assert (run.verification.board_displacement_m, run.verification.board_rotation_rad) == (0.009, 0.002)
    assert (run.verification.views[0].deviation_m, run.verification.views[0].deviation_rad) == (0.009, 0.002)
    assert (run.progress.views[0].corners, run.progress.views[0].board_corners) == (40, 48)


WARNINGS_8 = ['view 3 was excluded: it "moved"', '{"warnings": []}', "größer als 4,2 mm"]
SUMMARIES_8: dict[str, str | bytes | None] = {
    "partial": json.dumps({"chains": 2, "crossings": 1, "warnings": WARNINGS_8, "partial": True}),
    "whole": json.dumps({"chains": 1, "crossings": 0, "warnings": [], "partial": False}),
    "older": json.dumps({"chains": 1, "crossings": 0, "warnings": []}),
    "many": json.dumps({"chains": 1, "crossings": 0, "warnings": [str(k) for k in range(25)], "partial": False}),
    "failed": None,
    "no-json": '{"chains": 1, "warnings": [',
    "no-object": "5",
    "no-list": '{"chains": 1, "crossings": 0, "warnings": {"a": 1}}',
    "no-text": b"\xff{}",
}
"""Summaries of version 8 by the id of their scan."""


def doubts_9(messages: list[str]) -> list[dict[str, str]]:
    return [{"code": "pointchain-1", "severity": "doubt", "message": message} for message in messages]


SUMMARIES_9 = {
    "partial": {"chains": 2, "crossings": 1, "verdict": "review", "doubts": doubts_9(WARNINGS_8), "doubt_count": 3,
                "note_count": 0, "partial": True},
    "whole": {"chains": 1, "crossings": 0, "verdict": "review", "doubts": [], "doubt_count": 0, "note_count": 0,
              "partial": False},
    "older": {"chains": 1, "crossings": 0, "verdict": "review", "doubts": [], "doubt_count": 0, "note_count": 0,
              "partial": False},
    "many": {"chains": 1, "crossings": 0, "verdict": "review", "doubts": doubts_9([str(k) for k in range(20)]),
             "doubt_count": 25, "note_count": 0, "partial": False},
}  # fmt: skip
"""The same summaries in version 9. Those that are missing here are unchanged."""


def test_summaries_of_version_8_get_a_verdict_and_doubts(tmp_path: Path) -> None:
    with closing(DataFolder(tmp_path)) as folder:
        with database_of_version(8, folder) as db:
            columns = "id, mode, method, state, fraction, created_at, summary"
            sql = f"INSERT INTO scans ({columns}) VALUES (?, 'live', 'graph', 'succeeded', 1.0, '08:54', ?)"
            db.executemany(sql, SUMMARIES_8.items())
        with closing(Store(folder)) as store:
            rows = [store.scans.get(name) for name in SUMMARIES_9]
        with closing(sqlite3.connect(folder.database)) as db:
            stored = dict(db.execute("SELECT id, summary FROM scans").fetchall())
    assert len(SUMMARIES_9["many"]["doubts"]) == MAX_SUMMARY_DOUBTS
    for row in rows:
        assert row is not None
        assert row.summary is not None
        assert row.summary == SUMMARIES_9[row.id]
        assert row.summary["partial"] is SUMMARIES_9[row.id]["partial"], "not 0 or 1"
        assert row.all_grasps is False
        shown = scan_resource(row, []).model_dump(mode="json")["summary"]
        assert shown == {name: value for name, value in row.summary.items() if name != "partial"}
    unchanged = SUMMARIES_8.keys() - SUMMARIES_9.keys()
    assert {name: stored[name] for name in unchanged} == {name: SUMMARIES_8[name] for name in unchanged}


def test_events_of_version_8_get_a_verdict_and_doubts(tmp_path: Path) -> None:
    state = {"state": "succeeded", "stage": None, "fraction": 1.0, "failure": None}
    kept = {
        "view": json.dumps({"index": 0, "summary": {"warnings": []}}),  # another kind of event
        "state": json.dumps(state | {"state": "processing", "fraction": 0.5, "summary": None}),
        "state ": '{"summary": {"warnings": [',
    }
    with closing(DataFolder(tmp_path)) as folder:
        with database_of_version(8, folder) as db:
            columns = "id, mode, method, state, fraction, created_at"
            for scan in (*SUMMARIES_9, "other"):
                sql = f"INSERT INTO scans ({columns}) VALUES (?, 'live', 'graph', 'succeeded', 1.0, '08:54')"
                db.execute(sql, (scan,))
            sql = "INSERT INTO events (scan, at, kind, data) VALUES (?, '08:54', ?, ?)"
            for scan in SUMMARIES_9:
                text = SUMMARIES_8[scan]
                assert isinstance(text, str)
                db.execute(sql, (scan, "state", json.dumps(state | {"summary": json.loads(text)})))
            for kind, text in kept.items():
                db.execute(sql, ("other", kind.strip(), text))
        with closing(Store(folder)) as store:
            for scan, summary in SUMMARIES_9.items():
                missed = store.events.since(scan, 0)
                assert missed is not None
                (event,) = missed.events
                assert event.data == state | {"summary": summary}
                shown = {name: value for name, value in summary.items() if name != "partial"}
                (data,) = (line for line in change_event(event).decode().splitlines() if line.startswith("data: "))
                assert json.loads(data.removeprefix("data: "))["data"]["summary"] == shown
        with closing(sqlite3.connect(folder.database)) as db:
            texts = [text for (text,) in db.execute("SELECT data FROM events WHERE scan = 'other' ORDER BY id")]
    assert texts == list(kept.values())
