"""One scan or calibration at a time: from its acceptance to its final state.

A thread of its own hands scans to the recognition process, does calibrations, and writes down what becomes of them.
There is no queue: a cell has one arm, and whoever asks while it is busy is told so.
"""

import logging
import math
import queue
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any

from cell.control.cell import Cell
from cell.control.stop_requests import STOPPED_SINCE
from cell.errors import StoppedError
from recognition.grasping.gripper import Gripper
from service.errors import ServiceError
from service.jobs.calibration_drift import DriftWatch
from service.jobs.calibration_job import CalibrationRunner
from service.jobs.cell_lock import Place
from service.jobs.job import Running, kind
from service.jobs.live_scan import keep_recording
from service.jobs.scan_job import ScanRunner
from service.jobs.submission import Submissions
from service.logs.request_time import arrived_s
from service.metrics.scans import ScanMetrics
from service.processing.worker import RecognitionWorker
from service.states import ScanState
from service.storage.rows import CalibrationRow, ScanRow
from service.storage.store import KEPT, Store

log = logging.getLogger(__name__)

SETTLE_S = 5.0
"""Whoever cancels a scan waits for its end so long. It takes milliseconds, but for a camera that is just being looked
for again, and for a database that another program holds."""

STOPPED_S = 1.0
"""Whoever stops the arm waits no longer than this for it to end what it was at: he wants to know that it was told."""

PICTURE_S = 3.0
"""A scan that is cancelled while the picture of the last one is being drawn waits so long for that, which takes half a
second."""

BY_ITSELF_S = 0.3
"""A live scan that is stopped has so long to end before its recognition is killed: the next one would wait for a new
process."""

IDLE_CHECK_S = 1.0
"""While there is nothing to do, how often it is made sure that a recognition process waits."""


class Jobs:
    """Runs scans and calibrations. Every method may be called from any thread and may block for a moment."""

    def __init__(
        self,
        store: Store,
        cell: Cell,
        recognition_limit_s: float,
        gripper: Gripper,
        metrics: ScanMetrics | None = None,
    ) -> None:
        """Marks what an earlier service left unfinished as interrupted, keeps what earlier ones had recorded, and
        starts the recognition process."""
        self._store = store
        self._cell = cell
        self._worker = RecognitionWorker()
        self._metrics = metrics or ScanMetrics()
        self._place = Place()
        self._stopped_s = -math.inf
        """When somebody last asked to stop the arm, whatever goes on."""
        self.drift = DriftWatch(store.calibrations)
        """What recent scans tell of the calibration in use."""
        self._scans = ScanRunner(
            store, cell, self._worker, recognition_limit_s, gripper, self._place.leaving, self.drift, self._metrics
        )
        self._calibrations = CalibrationRunner(store, cell, self._place.leaving)
        self._notes = ThreadPoolExecutor(1, thread_name_prefix="stopping")
        """Writes that something is being stopped: nobody who stops it waits for the database."""
        self._accepted: queue.SimpleQueue[Running[Any] | None] = queue.SimpleQueue()
        self.submit = Submissions(store, cell, self._place, self._accepted.put)
        """Where scans and calibrations are asked for."""
        store.interrupt_unfinished()
        store.calibrations.interrupt_unfinished()
        # Not only of those: an earlier start may have been killed at this point, or the database was locked before.
        for scan in store.scans_without_recording():
            try:
                keep_recording(store, scan.id)
            except OSError:
                log.exception("the recording of scan %s cannot be read; the next start tries again", scan.id)
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()

    def wind_up(self) -> None:
        """Takes no more scans or calibrations, and stops the one under way, if any: it becomes `interrupted`."""
        self._place.refuse_more()
        # Whoever leaves the place may be waiting for the database; the arm is not to wait with him.
        running = self._place.running
        if running is not None or self._cell.status.state == "busy":  # an arm at rest is let go, and no program ended
            self._interrupt(running)
        accepted_last = self._place.close()
        if accepted_last is not None and accepted_last is not running:
            self._interrupt(accepted_last)
        self._cell.cancel_connecting()

    def close(self) -> None:
        """Winds up, and ends the recognition process."""
        try:
            self.wind_up()
        finally:
            self._worker.kill()  # it may be starting
            self._accepted.put(None)
            self._thread.join()
            self._notes.shutdown()
            self._worker.close()

    @property
    def not_ready(self) -> str | None:
        """Why no scan can be done now, or None: a busy service is ready."""
        return self._worker.not_ready

    def nothing_else(self) -> AbstractContextManager[None]:
        """A moment in which nothing is under way or begins.

        Raises:
            ServiceError: `cell-busy`, with what is under way.
        """
        return self._place.taken()

    def draws(self, scan_id: str) -> bool:
        """Whether the picture of a scan that has a result is still being drawn."""
        return self._scans.drawing == scan_id

    def cancel(self, row_id: str, find: Callable[[], ScanRow | CalibrationRow]) -> None:
        """Stops the scan or calibration of this id, the arm first, and waits until it has ended; it may have succeeded
        just before. `find` gives its row, and is asked only when it is not under way.

        Raises:
            ServiceError: `not-cancellable` when it had ended already, unless it was aborted; what `find` raises.
        """
        running = self._place.running
        if running is not None and running.row.id == row_id:
            # The arm of a scan that has just ended may be at work for the next one.
            arm = running.prepared is not None and not running.ended.is_set()
            self._stop(running, "aborted", f"the {kind(running.row)} was cancelled", arm)
            running.ended.wait(SETTLE_S)
        elif (row := find()).state != "aborted":
            raise ServiceError("not-cancellable", f"the {kind(row)} is {row.state} already")

    def stop_arm(self, reason: str = "the arm was stopped by request") -> str | None:
        """Stops the arm, whatever goes on, and aborts the live scan or calibration under way, if any; the scan's id.

        Waits for what the arm is at, a move or a look: what was recorded is still being kept then, and the scan ends
        behind that.
        """
        self._stopped_s = time.monotonic()
        running = self._place.running
        live = running if running is not None and running.prepared is not None else None
        self._stop(live, "aborted", reason)
        self._cell.wait_while_busy(STOPPED_S)
        return live.row.id if live is not None and isinstance(live.row, ScanRow) else None

    def refuse_stopped_since(self, wished_s: float) -> None:
        """Raises StoppedError when somebody has asked to stop the arm since then, by `time.monotonic()`.

        A scan that was cancelled, or ended with the service, is no reason to refuse others.
        """
        if self._stopped_s >= wished_s:
            raise StoppedError(STOPPED_SINCE)

    def stop_unattended(self) -> None:
        """Stops an arm that moves or is about to, because the service does not answer: nobody else could stop it."""
        self._cell.reject_earlier_requests()  # what is not accepted yet
        if self._cell.status.state == "busy" or self.using_arm is not None:
            self.stop_arm("the service did not answer for more than a second, so nobody could have stopped the arm")

    def release_arm(self, requested_at: float) -> None:
        """Lets the arm go, once it is home; refused when the arm was stopped since `requested_at`.

        Raises:
            ServiceError: `cell-busy`, with what is under way.
            CellError: as `Cell.release`.
        """
        with self._place.taken():
            self._cell.release(requested_at)

    @property
    def closed(self) -> bool:
        """Nothing more begins: the service is stopping."""
        return self._place.closed

    @property
    def recognition_starts(self) -> int:
        """How many recognition processes were started so far."""
        return self._worker.starts

    @property
    def idle(self) -> bool:
        """Nothing is accepted that has not ended."""
        return self._place.running is None

    @property
    def using_arm(self) -> str | None:
        """The live scan or calibration that is accepted and has not ended, if any, in words."""
        running = self._place.running
        return None if running is None or running.prepared is None else f"a {kind(running.row)}"

    @property
    def calibration(self) -> str | None:
        """Id of the calibration or verification that is accepted and has not ended, if any."""
        running = self._place.running
        return running.row.id if running is not None and isinstance(running.row, CalibrationRow) else None

    def _interrupt(self, running: Running[Any] | None) -> None:
        if running is not None:
            running.given_up.set()
        of_scan = running is not None and isinstance(running.row, ScanRow)
        again = KEPT if of_scan else "start it again"
        self._stop(running, "interrupted", f"the service was stopped; {again}")
        if running is not None:
            running.ended.wait(SETTLE_S)

    def _stop(self, running: Running[Any] | None, state: ScanState, detail: str, arm: bool = True) -> None:
        """Stops the arm and what is under way, if anything is; it ends behind that."""
        # First the deed, then its record; the wish is only noted, so that a scan that the stop ends knows why.
        asked = running is not None and running.ask_to_stop(state, detail)
        if arm:
            since = arrived_s()
            self._cell.stop()
            self._metrics.stopped(time.monotonic() - since)
        if running is None or not asked:
            return
        try:
            if isinstance(running.row, ScanRow):
                self._end_recognition(running)
            self._notes.submit(self._note_stopping, running)
        except RuntimeError:  # no other thread can be had: it is stopped all the same
            log.exception("that %s is being stopped could not be written", running.words)

    def _note_stopping(self, running: Running[Any]) -> None:
        update = self._store.update_scan if isinstance(running.row, ScanRow) else self._store.calibrations.update
        try:
            update(running.row.id, state="stopping")
        except sqlite3.Error:
            log.exception("that %s is being stopped could not be written", running.words)

    def _end_recognition(self, running: Running[Any]) -> None:
        begun = running.begun.is_set()
        if begun and running.prepared is None:
            self._kill_unless_ended(running, 0.0)
            return
        # A live one ends with its arm, and recognition waits for the next; unless it is at work on the last views.
        wait_s = BY_ITSELF_S if begun or running.given_up.is_set() else PICTURE_S
        threading.Thread(target=self._kill_unless_ended, args=(running, wait_s), name="ending").start()

    def _kill_unless_ended(self, running: Running[Any], wait_s: float) -> None:
        if not running.ended.wait(wait_s):  # else it could by now be at work on the next one
            self._worker.kill()

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
            runner = self._scans if isinstance(running.row, ScanRow) else self._calibrations
            running.begun.set()
            runner.run(running)
            if self._accepted.empty():  # the next one, which may have been cancelled by now, does it if it must
                self._prepare()

    def _prepare(self) -> None:
        if not self._place.closed:
            self._worker.prepare()
