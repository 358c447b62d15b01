"""One scan at a time: from its acceptance to its final state.

A thread of its own hands scans to the recognition process and writes down what becomes of them. There is no
queue: a cell has one arm, and whoever asks while it is busy is told so.
"""

import logging
import queue
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from cell.cell import Cell
from cell.viewpoints import ViewpointPlan
from recognition.gripper import Gripper
from recognition.model import Method
from service.live import keep_recording
from service.problems import ProblemError
from service.running import Running
from service.scan_runner import ScanRunner
from service.schemas import ScanState
from service.store import Store, new_id, now
from service.tables import RecordingRow, ScanRow
from service.worker import RecognitionWorker

log = logging.getLogger(__name__)

SETTLE_S = 5.0
"""Whoever stops a scan waits for its end so long. It takes milliseconds, but for a camera that is just being looked
for again."""

IDLE_CHECK_S = 1.0
"""While there is nothing to do, how often it is made sure that a recognition process waits."""


class Jobs:
    """Runs scans. Every method may be called from any thread and may block for a moment."""

    def __init__(self, store: Store, cell: Cell, recognition_limit_s: float, gripper: Gripper) -> None:
        """Marks what an earlier service left unfinished as interrupted, keeps what earlier ones had recorded, and
        starts the recognition process."""
        self._store = store
        self._cell = cell
        self._worker = RecognitionWorker()
        self._runner = ScanRunner(store, cell, self._worker, recognition_limit_s, gripper, self._leaving)
        self._turn = threading.Lock()
        """Of taking and leaving the one place, each together with its row: whoever reads that a scan has
        ended finds the place free."""
        self._running: Running | None = None
        self._preparing = False
        """The place is taken for a live scan that is not accepted yet."""
        self._closing = False
        self._accepted: queue.SimpleQueue[Running | None] = queue.SimpleQueue()
        store.interrupt_unfinished()
        # Not only of those: an earlier start may have been killed at this point, or the database was locked before.
        for scan in store.scans_without_recording():
            try:
                keep_recording(store, scan.id)
            except OSError:
                log.exception("the recording of scan %s cannot be read; the next start tries again", scan.id)
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()

    def wind_up(self) -> None:
        """Takes no more scans, and stops the one under way, if any: it becomes `interrupted`."""
        with self._turn:
            self._closing = True
            running = self._running
        if running is not None or self._cell.status.state == "busy":  # an arm at rest is let go, and no program ended
            self._stop(running, "interrupted", "the service was stopped; start it again from its recording")
        self._cell.give_up_connecting()

    def close(self) -> None:
        """Winds up, and ends the recognition process."""
        try:
            self.wind_up()
        finally:
            self._worker.kill()  # it may be starting
            self._accepted.put(None)
            self._thread.join()
            self._worker.close()

    @property
    def not_ready(self) -> str | None:
        """Why no scan can be done now, or None: a busy service is ready."""
        return self._worker.not_ready

    def submit_replay(self, recording: RecordingRow, method: Method, radius_m: float | None) -> ScanRow:
        """Accepts a scan from a recording; on return it is on the disk.

        Raises:
            ProblemError: `cell-busy`, with the Location of the scan under way.
        """
        with self._place():
            return self._accept("replay", method, radius_m, recording.id, None)

    def submit_live(self, views: int | None, method: Method, radius_m: float | None) -> ScanRow:
        """Accepts a scan by the cell once the cell is ready and the scan is planned; on return it is on the disk.

        Takes seconds where the cell has to be connected first. Nothing moves before the scan is accepted.

        Raises:
            ProblemError: `cell-busy`, with the Location of the scan under way.
            CellError: why the cell cannot do it.
        """
        with self._place():
            plan = self._cell.prepare(views)
            return self._accept("live", method, radius_m, None, plan)

    def wait_for_preview(self, scan_id: str) -> None:
        """Returns when the picture of a scan that has a result is there, or will not be."""
        self._runner.wait_for_preview(scan_id)

    def cancel(self, scan: ScanRow) -> None:
        """Stops a scan, the arm first, and waits until it has ended; it may have succeeded just before.

        Raises:
            ProblemError: `not-cancellable` when it had ended already, unless it was aborted.
        """
        running = self._running
        if running is not None and running.scan.id == scan.id:
            # The arm of a scan that has just ended may be at work for the next one.
            arm = running.plan is not None and not running.ended.is_set()
            self._stop(running, "aborted", "the scan was cancelled", arm)
        elif scan.state != "aborted":
            raise ProblemError(409, "not-cancellable", f"the scan is {scan.state} already")

    def stop_arm(self) -> None:
        """Stops the arm, whatever goes on, and aborts the live scan under way, if any."""
        running = self._running
        live = running is not None and running.plan is not None
        self._stop(running if live else None, "aborted", "the arm was stopped by request")

    def release_arm(self) -> None:
        """Lets the arm go, once it is home.

        Raises:
            ProblemError: `cell-busy`, with the Location of the scan under way.
            CellError: as `Cell.release`.
        """
        with self._place():
            self._cell.release()

    @property
    def live_scan(self) -> str | None:
        """Id of the live scan that is accepted and has not ended, if any."""
        running = self._running
        return None if running is None or running.plan is None else running.scan.id

    @contextmanager
    def _place(self) -> Iterator[None]:
        """The one place, for as long as it takes to accept a scan."""
        with self._turn:
            if self._closing:
                raise ProblemError(503, "not-ready", "the service is stopping")
            if self._running is not None:
                busy = self._running.scan.id
                raise ProblemError(
                    409,
                    "cell-busy",
                    f"scan {busy} is under way; wait for its end or cancel it",
                    {"Location": f"/api/scans/{busy}"},
                )
            if self._preparing:
                raise ProblemError(409, "cell-busy", "another scan is being prepared; try again in some seconds")
            self._preparing = True
        try:
            yield
        finally:
            self._preparing = False

    def _accept(
        self,
        mode: Literal["replay", "live"],
        method: Method,
        radius_m: float | None,
        recording: str | None,
        plan: ViewpointPlan | None,
    ) -> ScanRow:
        scan = ScanRow(
            id=new_id(),
            mode=mode,
            recording=recording,
            method=method,
            string_radius_m=radius_m,
            state="queued",
            stage=None,
            fraction=0.0,
            created_at=now(),
            started_at=None,
            ended_at=None,
            summary=None,
            problem=None,
        )
        with self._turn:
            if self._closing:
                raise ProblemError(503, "not-ready", "the service is stopping")
            self._store.add_scan(scan)
            self._running = Running(scan, plan)
            self._accepted.put(self._running)
        return scan

    def _stop(self, running: Running | None, state: ScanState, detail: str, arm: bool = True) -> None:
        """Stops the arm and the scan under way, if any, and waits for the scan's end."""
        # First the deed, then its record; the wish is only noted, so that a scan that the stop ends knows why.
        asked = running is not None and running.ask_to_stop(state, detail)
        if arm:
            self._cell.stop()
        if running is None:
            return
        if asked and not running.ended.is_set():  # it could by now be at work on the next one
            self._worker.kill()
        try:
            if running.stop is not None:
                self._store.update_scan(running.scan.id, state="stopping")
        except sqlite3.OperationalError:
            log.exception("that scan %s is being stopped could not be written", running.scan.id)
        running.ended.wait(SETTLE_S)

    def _work(self) -> None:
        self._prepare()
        while True:
            try:
                running = self._accepted.get(timeout=IDLE_CHECK_S)
            except queue.Empty:
                self._prepare()  # should recognition have died, a new process is ready for the next scan
                continue
            if running is None:
                return
            self._runner.run(running)
            if self._accepted.empty():  # the next one, which may have been cancelled by now, does it if it must
                self._prepare()

    def _prepare(self) -> None:
        if not self._closing:
            self._worker.prepare()

    @contextmanager
    def _leaving(self, running: Running) -> Iterator[None]:
        with self._turn:
            try:
                yield
            finally:
                if self._running is running:
                    self._running = None
