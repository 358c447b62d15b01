"""Fault 23: the machine's clock is set, by a day, in the middle of things."""

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
from service.clock import ClockStepDetector
from service.config.sections import RetentionConfig
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.database import new_id
from service.storage.retention import Retention
from service.storage.rows import insert
from service.storage.store import Store
from tests.service.conftest import Serve, wait_until
from tests.service.faults.pretended_recognition import pretended
from tests.service.following import folded, told
from tests.service.live_cell import live_cell

pytestmark = [pytest.mark.fault(23), pytest.mark.xdist_group("cell")]

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
DAY = timedelta(days=1)


class Clock:
    """The wall clock, to be set."""

    def __init__(self) -> None:
        self.off = timedelta()

    def utc_now(self) -> datetime:
        return datetime.now(UTC) + self.off


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Of the service, and of the cell where it judges a calibration's age."""
    clock = Clock()
    monkeypatch.setattr("service.clock.utc_now", clock.utc_now)

    class Moment(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) + clock.off

    for module in ("calibration.storage.hand_eye_file", "cell.control.cell"):
        monkeypatch.setattr(f"{module}.datetime", Moment)
    monkeypatch.setattr(time, "time", lambda real=time.time: real() + clock.off.total_seconds())
    return clock


@pytest.mark.parametrize("days", [-1, 1])
def test_ids_rise_in_order_of_their_making(clock: Clock, days: int) -> None:
    made = [new_id() for _ in range(1000)]
    clock.off = days * DAY
    made += [new_id() for _ in range(1000)]
    clock.off = -days * DAY
    made += [new_id() for _ in range(1000)]
    clock.off = timedelta()
    made += [new_id() for _ in range(1000)]
    assert made == sorted(made)
    assert len(set(made)) == len(made)


NEW_ID = """
import datetime, pathlib, sys
from service.storage.data_folder import DataFolder
from service.jobs.submission import NOBODY, new_scan
from service.storage.store import Store
from service import clock as wall_clock
off = datetime.timedelta(days=float(sys.argv[2]))
wall_clock.utc_now = lambda real=wall_clock.utc_now: real() + off
store = Store(DataFolder(pathlib.Path(sys.argv[1])))
store.scans.add(new_scan("replay", "graph", None, NOBODY))
"""


def test_a_later_service_goes_on_behind_the_last_id(clock: Clock, tmp_path: Path) -> None:
    # A process of its own, as a service has: what it remembers is lost.
    subprocess.run([sys.executable, "-c", NEW_ID, str(tmp_path), "1"], check=True)
    clock.off = -DAY
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        store.scans.add(scan := new_scan("replay", "graph", None, NOBODY))
        with store.database.connection() as db:
            in_order = [row["id"] for row in db.execute("SELECT id FROM scans ORDER BY rowid")]
        assert len(in_order) == 2
        assert in_order == sorted(in_order)
        assert [row.id for row in store.scans.newest(10)] == in_order[::-1]
        assert [row.id for row in store.scans.newest(10, before=scan.id)] == in_order[-2::-1]


def test_ids_that_are_not_ours_are_no_moments(tmp_path: Path) -> None:
    with closing(DataFolder(tmp_path)) as folder:
        with closing(Store(folder)) as store, store.database.transaction() as db:
            for name in ("upload-1", "99999999t999999-999999-ffffffff", "zz"):
                insert(db, "scans", replace(new_scan("replay", "graph", None, NOBODY), id=name))
        before = new_id()
        with closing(Store(folder)):
            assert before < new_id() < "21"


# What is old is removed only by a clock that goes steadily


def test_a_clock_that_was_set_is_found_out(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 1000.0
    monkeypatch.setattr("service.clock.time.monotonic", lambda: now_s)
    monkeypatch.setattr("service.clock.utc_now", lambda: datetime.fromtimestamp(now_s, UTC) + clock.off)
    detector = ClockStepDetector()
    now_s += 5000.0
    clock.off += timedelta(seconds=2)  # as a clock that is brought to the right time slowly
    assert detector.seconds_since_step() == 5000.0
    for off in (DAY, -DAY, timedelta(minutes=-2)):
        clock.off += off
        now_s += 10.0
        assert detector.seconds_since_step() == 0.0
        now_s += 10.0
        assert detector.seconds_since_step() == 10.0


@contextmanager
def kept_for_a_week(store: Store) -> Iterator[None]:
    """Somebody looks for what is older than a week, all the time."""
    with closing(Retention(store, RetentionConfig(max_age_days=7), lambda: True)):
        yield


def test_nothing_is_removed_because_the_clock_was_set(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.storage.retention.RETRY_S", 0.02)
    monkeypatch.setattr("service.storage.retention.INTERVAL_S", 0.02)
    monkeypatch.setattr("service.storage.retention.STEADY_S", 0.3)
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        store.scans.add(new_scan("replay", "graph", None, NOBODY))
        (scan,) = store.scans.newest(1)
        store.scans.update(scan.id, state="failed", ended_at="2026-01-01T00:00:00.000Z")
        ended = datetime(2026, 1, 1, tzinfo=UTC)

        def days_after(days: float) -> timedelta:
            return ended + timedelta(days=days) - datetime.now(UTC)

        clock.off = days_after(6.5)
        with kept_for_a_week(store):
            for _ in range(5):  # a day forth, and right again before it can be believed
                clock.off = days_after(7.5)
                time.sleep(0.1)
                clock.off = days_after(6.5)
                time.sleep(0.1)
            assert store.scans.get(scan.id) is not None
            clock.off = days_after(7.5)  # for good
            wait_until(lambda: store.scans.get(scan.id) is None)


@pytest.mark.parametrize("days", [-1, pytest.param(1, marks=pytest.mark.soak)])
def test_a_scan_goes_on(
    clock: Clock,
    serve: Serve,
    tmp_path: Path,
    recording_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    finished: Finished,
    days: int,
) -> None:
    """Of a calibration that is nearly too old, or made a moment ago, whichever the clock could spoil."""
    monkeypatch.setattr("service.jobs.manager.RecognitionWorker", pretended(recording_file))
    file = tmp_path / "hand_eye.json"
    write_hand_eye(
        file, T_FLANGE_CAMERA, created=datetime.now(UTC) - (timedelta(days=89.9) if days > 0 else timedelta())
    )
    with live_cell(serve, tmp_path / "data", time_factor=5.0, hand_eye={"file": file}) as cell:
        first = finished(cell.client, cell.start(views=2))
        location = cell.start(views=3)
        cell.wait_for_motion(location)
        clock.off = days * DAY
        scan = finished(cell.client, location)
        assert scan["state"] == "succeeded", scan["problem"]
        assert len(cell.views(location)) == 3
        assert folded(told(cell.client, f"{location}/events"))["state"] == "succeeded"
        listed = cell.client.get("/api/scans").json()["scans"]
        assert [one["id"] for one in listed] == [scan["id"], first["id"]]
        assert cell.client.get(f"/api/scans?before={scan['id']}").json()["scans"] == [listed[1]]
        recorded = cell.client.get("/api/recordings").json()["recordings"]
        assert [one["id"] for one in recorded] == [scan["id"], first["id"]]
        again = cell.client.post(f"{location}/reprocess")
        assert finished(cell.client, again.headers["Location"])["state"] == "succeeded"
        if days < 0:  # a day older it would be too old: that is what its age is for
            assert cell.client.post("/api/viewpoints/plan", json={}).status_code == 200
        assert cell.client.get("/api/calibration").status_code == 200
        assert cell.client.get("/readyz").status_code == 200
