"""Fault 23: the machine's clock is set forward or back by a day while the service runs."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx2
import pytest

from calibration.storage.hand_eye_file import write_hand_eye
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from recognition.request import RecognitionRequest
from service.clock import ClockStepDetector
from service.config.sections import RetentionConfig
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.database import new_id
from service.storage.retention import Retention
from service.storage.rows import insert
from service.storage.store import Store
from tests.service.conftest import Serve, wait_until
from tests.service.faults.recognition_stub import stub_factory
from tests.service.following import fold_events, read_events
from tests.service.live_cell import live_cell

pytestmark = [pytest.mark.fault(23), pytest.mark.xdist_group("service")]

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
DAY = timedelta(days=1)


class Clock:
    """A wall clock with an adjustable offset."""

    def __init__(self) -> None:
        self.offset = timedelta()

    def utc_now(self) -> datetime:
        return datetime.now(UTC) + self.offset


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of the service, and of the cell when it checks the age of a calibration."""
    clock = Clock()
    monkeypatch.setattr("service.clock.utc_now", clock.utc_now)

    class ShiftedDatetime(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) + clock.offset

    for module in ("calibration.storage.hand_eye_file", "cell.control.cell"):
        monkeypatch.setattr(f"{module}.datetime", ShiftedDatetime)
    monkeypatch.setattr(time, "time", lambda real=time.time: real() + clock.offset.total_seconds())
    return clock


@pytest.mark.parametrize("days", [-1, 1])
def test_ids_rise_in_order_of_creation(clock: Clock, days: int) -> None:
    ids = [new_id() for _ in range(1000)]
    clock.offset = days * DAY
    ids += [new_id() for _ in range(1000)]
    clock.offset = -days * DAY
    ids += [new_id() for _ in range(1000)]
    clock.offset = timedelta()
    ids += [new_id() for _ in range(1000)]
    assert ids == sorted(ids)
    assert len(set(ids)) == len(ids)


NEW_ID = """
import datetime, pathlib, sys
from recognition.request import RecognitionRequest
from service.storage.data_folder import DataFolder
from service.jobs.submission import NOBODY, new_scan
from service.storage.store import Store
from service import clock as wall_clock
off = datetime.timedelta(days=float(sys.argv[2]))
wall_clock.utc_now = lambda real=wall_clock.utc_now: real() + off
store = Store(DataFolder(pathlib.Path(sys.argv[1])))
store.scans.add(new_scan("replay", RecognitionRequest(), NOBODY))
"""


def test_a_later_service_continues_after_the_last_id(clock: Clock, tmp_path: Path) -> None:
    # The earlier service is another process, so no state in memory remains.
    subprocess.run([sys.executable, "-c", NEW_ID, str(tmp_path), "1"], check=True)
    clock.offset = -DAY
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        store.scans.add(scan := new_scan("replay", RecognitionRequest(), NOBODY))
        with store.database.connection() as db:
            in_order = [row["id"] for row in db.execute("SELECT id FROM scans ORDER BY rowid")]
        assert len(in_order) == 2
        assert in_order == sorted(in_order)
        assert [row.id for row in store.scans.newest(10)] == in_order[::-1]
        assert [row.id for row in store.scans.newest(10, before=scan.id)] == in_order[-2::-1]


def test_foreign_ids_are_not_read_as_times(tmp_path: Path) -> None:
    with closing(DataFolder(tmp_path)) as folder:
        with closing(Store(folder)) as store, store.database.transaction() as db:
            for name in ("upload-1", "99999999t999999-999999-ffffffff", "zz"):
                insert(db, "scans", replace(new_scan("replay", RecognitionRequest(), NOBODY), id=name))
        before = new_id()
        with closing(Store(folder)):
            assert before < new_id() < "21"


# Retention removes old data only while the clock is steady


def test_a_clock_step_is_detected(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 1000.0
    monkeypatch.setattr("service.clock.time.monotonic", lambda: now_s)
    monkeypatch.setattr("service.clock.utc_now", lambda: datetime.fromtimestamp(now_s, UTC) + clock.offset)
    detector = ClockStepDetector()
    now_s += 5000.0
    clock.offset += timedelta(seconds=2)  # a slow correction of the clock
    assert detector.seconds_since_step() == 5000.0
    for offset in (DAY, -DAY, timedelta(minutes=-2)):
        clock.offset += offset
        now_s += 10.0
        assert detector.seconds_since_step() == 0.0
        now_s += 10.0
        assert detector.seconds_since_step() == 10.0


@contextmanager
def retention_of_a_week(store: Store) -> Iterator[None]:
    """Run retention with a maximum age of a week during the body."""
    with closing(Retention(store, RetentionConfig(max_age_days=7), lambda: True)):
        yield


def test_a_clock_step_removes_nothing(clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.storage.retention.RETRY_S", 0.02)
    monkeypatch.setattr("service.storage.retention.INTERVAL_S", 0.02)
    monkeypatch.setattr("service.storage.retention.STEADY_S", 0.3)
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        store.scans.add(new_scan("replay", RecognitionRequest(), NOBODY))
        (scan,) = store.scans.newest(1)
        store.scans.update(scan.id, state="failed", ended_at="2026-01-01T00:00:00.000Z")
        ended = datetime(2026, 1, 1, tzinfo=UTC)

        def days_after(days: float) -> timedelta:
            return ended + timedelta(days=days) - datetime.now(UTC)

        clock.offset = days_after(6.5)
        with retention_of_a_week(store):
            for _ in range(5):  # a day forward, and back before the clock counts as steady
                clock.offset = days_after(7.5)
                time.sleep(0.1)
                clock.offset = days_after(6.5)
                time.sleep(0.1)
            assert store.scans.get(scan.id) is not None
            clock.offset = days_after(7.5)  # permanently
            wait_until(lambda: store.scans.get(scan.id) is None)


@pytest.mark.parametrize("days", [-1, pytest.param(1, marks=pytest.mark.soak)])
def test_a_scan_succeeds_after_a_clock_step(
    clock: Clock,
    serve: Serve,
    tmp_path: Path,
    recording_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    finished: Finished,
    days: int,
) -> None:
    """The calibration is nearly too old or just made, so that the clock step could invalidate it."""
    monkeypatch.setattr("service.jobs.manager.RecognitionWorker", stub_factory(recording_file))
    file = tmp_path / "hand_eye.json"
    write_hand_eye(
        file, T_FLANGE_CAMERA, created=datetime.now(UTC) - (timedelta(days=89.9) if days > 0 else timedelta())
    )
    with live_cell(serve, tmp_path / "data", time_factor=5.0, hand_eye={"file": file}) as cell:
        first = finished(cell.client, cell.start(views=2))
        location = cell.start(views=3)
        cell.wait_for_motion(location)
        clock.offset = days * DAY
        scan = finished(cell.client, location)
        assert scan["state"] == "succeeded", scan["problem"]
        assert len(cell.views(location)) == 3
        assert fold_events(read_events(cell.client, f"{location}/events"))["state"] == "succeeded"
        listed = cell.client.get("/api/scans").json()["scans"]
        assert [one["id"] for one in listed] == [scan["id"], first["id"]]
        assert cell.client.get(f"/api/scans?before={scan['id']}").json()["scans"] == [listed[1]]
        recorded = cell.client.get("/api/recordings").json()["recordings"]
        assert [one["id"] for one in recorded] == [scan["id"], first["id"]]
        again = cell.client.post(f"{location}/reprocess")
        assert finished(cell.client, again.headers["Location"])["state"] == "succeeded"
        if days < 0:  # with the clock a day ahead, the calibration is too old
            assert cell.client.post("/api/viewpoints/plan", json={}).status_code == 200
        assert cell.client.get("/api/calibration").status_code == 200
        assert cell.client.get("/readyz").status_code == 200
