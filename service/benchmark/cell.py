"""Measure a live scan of the simulated cell at the speed of a real one, and how soon a stop stops the arm."""

import random
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cell.arm.ur_arm import UrArm
from cell.config.arm_config import SimulatedArm
from cell.config.cell_config import CellSettings
from cell.config.scan_views import Views
from cell.control.cell import Cell
from cell.errors import StoppedError
from cell.recording import read_recording
from cell.simulation.benchmark.tables import table
from cell.simulation.ur_controller.admin_client import AdminClient
from cell.simulation.ur_controller.launcher import start_controller
from recognition.request import RecognitionRequest
from service.benchmark.service_process import MeasurementError
from service.config.sections import LimitsConfig
from service.jobs.manager import Jobs
from service.states import ACTIVE_STATES
from service.storage.data_folder import DataFolder
from service.storage.rows import ScanRow
from service.storage.store import Store

RADIUS_M = 0.0042
"""Configured radius of the strings. To measure the radius, recognition would have to wait for all views."""
SCANS = 3
"""Number of scans, of which the median counts. A scan before them connects, and does not count."""
STOPS = 40
STOP_TO_Q_RAD = (0.6, -0.3, 0.3, 0.0, 0.0, 0.8)
"""The arm moves from home to home plus this, or back, and is stopped on its path."""
SEED = 1


@dataclass(frozen=True)
class CellTimes:
    """Times in seconds, except for the share and the count."""

    model_s: float
    """From the first move until the model is stored, with eight views."""
    scan_s: float
    """From the first move until the arm is home, with eight views."""
    motion_s: float
    """Part of `scan_s` in which the arm moves."""
    exposure_s: float
    """Part of `scan_s` in which the camera exposes the images of the median."""
    overhead: float
    """The rest of `scan_s`, as a share of it."""
    model_after_last_frame_s: float
    """From the end of the last exposure until the result is stored."""
    planning_s: float
    auto_views: float
    """Number of views with `auto`."""
    auto_model_s: float
    """From the first move until the model is stored, with `auto`."""
    auto_scan_s: float
    """From the first move until the arm is home, with `auto`."""
    stops: int
    stop_wire_p50_s: float
    """From the request for a stop until the controller receives it."""
    stop_wire_p99_s: float
    still_p99_s: float
    """From the request for a stop until the arm is still."""


def measure_cell(report: Callable[[str], None]) -> CellTimes:
    """Scan with the simulated cell in its default configuration, and stop its arm.

    Args:
        report: Called with a message on what is measured next.

    Returns:
        The medians of the scans, and the times of the stops.
    """
    scans, quick_scans = _scans(report)
    medians = {name: median(scan[name] for scan in scans) for name in scans[0] if name != "views"}
    quick = {name: median(scan[name] for scan in quick_scans) for name in ("views", "model_s", "scan_s")}
    return CellTimes(**medians, **{f"auto_{name}": value for name, value in quick.items()}, **_stops(report))


def cell_table(times: CellTimes) -> str:
    """Return the results as a table with one row for each."""
    return table(
        ("live scan of the simulated cell, eight views", ""),
        [
            ("from the first move to the stored model", f"{times.model_s:.1f} s"),
            ("from the first move until the arm is home", f"{times.scan_s:.1f} s"),
            ("arm in motion", f"{times.motion_s:.1f} s"),
            ("camera exposing", f"{times.exposure_s:.1f} s"),
            ("overhead, the rest", f"{times.overhead:.1%}"),
            ("from the last frame to the stored result", f"{times.model_after_last_frame_s:.2f} s"),
            ("planning", f"{times.planning_s:.2f} s"),
            (f"`auto`, {times.auto_views:.0f} views: to the stored model", f"{times.auto_model_s:.1f} s"),
            ("`auto`: until the arm is home", f"{times.auto_scan_s:.1f} s"),
            (
                f"stop to the controller, 50 % and 99 % of {times.stops}",
                f"{times.stop_wire_p50_s * 1000:.0f} ms, {times.stop_wire_p99_s * 1000:.0f} ms",
            ),
            ("stop to a still arm, 99 %", f"{times.still_p99_s * 1000:.0f} ms"),
        ],
    )


def _scans(report: Callable[[str], None]) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Return the times of the scans with eight views, and of those with `auto`."""
    settings = CellSettings()
    with tempfile.TemporaryDirectory(prefix="pointchain-") as root:
        folder = DataFolder(Path(root))
        store, cell = Store(folder), Cell(settings)
        jobs = Jobs(store, cell, LimitsConfig().recognition_s)
        try:
            report("cell: first live scan, which connects")
            _scan(store, cell, jobs)
            timed: dict[Views, list[dict[str, float]]] = {8: [], "auto": []}
            for number in range(1, SCANS + 1):
                for views, times in timed.items():
                    report(f"cell: live scan {number} of {SCANS} with {views} views")
                    times.append(_scan(store, cell, jobs, views))
            return timed[8], timed["auto"]
        finally:
            jobs.close()
            cell.close()
            store.close()
            folder.close()


def _scan(store: Store, cell: Cell, jobs: Jobs, views: Views = 8) -> dict[str, float]:
    accepted = jobs.submit.live(views, RecognitionRequest(radius_m=RADIUS_M), time.monotonic())
    while (scan := _row(store, accepted)).state in ACTIVE_STATES:
        time.sleep(0.01)
    if scan.state != "succeeded":
        raise MeasurementError(f"the scan ended {scan.state}: {scan.failure or scan.summary}")
    while cell.status.state == "busy":
        time.sleep(0.01)
    return _times(store, cell, scan)


def _row(store: Store, scan: ScanRow) -> ScanRow:
    row = store.scans.get(scan.id)
    assert row is not None
    return row


def _times(store: Store, cell: Cell, scan: ScanRow) -> dict[str, float]:
    """Return the times from the log of the controller, whose stamps use the monotonic clock of this machine."""
    assert scan.started_at is not None
    assert scan.ended_at is not None
    assert cell.controller_host is not None
    wall_s = time.time() - time.monotonic()
    began_s = datetime.fromisoformat(scan.started_at).timestamp() - wall_s
    admin = AdminClient(cell.controller_host)
    events = [event for event in admin.log() if event["stamp_s"] > began_s]
    admin.close()
    starts = [event["stamp_s"] for event in events if event["kind"] == "motion_start"]
    ends = [event["stamp_s"] for event in events if event["kind"] == "motion_done"]
    ended_s = datetime.fromisoformat(scan.ended_at).timestamp() - wall_s
    scan_s = ends[-1] - starts[0]
    motion_s = sum(end - start for start, end in zip(starts, ends, strict=True))
    views = read_recording(store.folder.recording(scan.id)).views
    exposure_s = len(views) * cell.settings.camera.exposures / cell.settings.camera.frame_rate
    last_frame_s = max(view.stamp_s for view in views) + 1 / cell.settings.camera.frame_rate
    plan = cell.status.plan
    assert plan is not None
    return {
        "views": len(views),
        "model_s": ended_s - starts[0],
        "scan_s": scan_s,
        "motion_s": motion_s,
        "exposure_s": exposure_s,
        "overhead": (scan_s - motion_s - exposure_s) / scan_s,
        "model_after_last_frame_s": datetime.fromisoformat(scan.ended_at).timestamp() - last_frame_s,
        "planning_s": plan.planning_s,
    }


def _stops(report: Callable[[str], None]) -> dict[str, Any]:
    """Stop the arm at random moments of a move, and return the times."""
    settings = SimulatedArm()
    rng = random.Random(SEED)
    wire_s, still_s = [], []
    with start_controller(settings.model) as controller:
        arm = UrArm(settings, controller.host)
        try:
            for number in range(STOPS):
                if number % 10 == 0:
                    report(f"cell: stop {number + 1} of {STOPS}")
                arm.connect()
                requested_s = _stop_once(arm, rng.uniform(0.05, 1.2), sign=(-1) ** number)
                wire, still = _stop_times(controller.admin, requested_s)
                wire_s.append(wire)
                still_s.append(still)
        finally:
            arm.close()
    return {
        "stops": STOPS,
        "stop_wire_p50_s": float(np.percentile(wire_s, 50)),
        "stop_wire_p99_s": float(np.percentile(wire_s, 99)),
        "still_p99_s": float(np.percentile(still_s, 99)),
    }


def _stop_once(arm: UrArm, after_s: float, sign: int) -> float:
    """Start a move, stop it after `after_s`, and return when the stop was requested (monotonic seconds)."""
    q_rad = arm.state().q_rad + sign * np.array(STOP_TO_Q_RAD)

    def move() -> None:
        with suppress(StoppedError):
            arm.move(q_rad)

    moving = threading.Thread(target=move, name="motion")
    moving.start()
    time.sleep(after_s)
    requested_s = time.monotonic()
    arm.stop()
    moving.join()
    return requested_s


def _stop_times(admin: AdminClient, requested_s: float) -> tuple[float, float]:
    """Return the seconds from the stop request until the controller receives it, and until the arm is still."""
    while admin.state().moving:
        time.sleep(0.01)
    events = [event for event in admin.log() if event["stamp_s"] >= requested_s]
    arrived = [event["stamp_s"] for event in events if event["kind"] in ("braking", "command", "dashboard")]
    still = [event["stamp_s"] for event in events if event["kind"] in ("still", "motion_done")]
    return min(arrived, default=requested_s) - requested_s, max(still, default=requested_s) - requested_s
