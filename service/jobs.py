"""One scan or calibration at a time: from its acceptance to its final state.

A thread of its own hands scans to the recognition process, does calibrations, and writes down what becomes of them.
There is no queue: a cell has one arm, and whoever asks while it is busy is told so.
"""

import logging
import queue
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from calibration.board import Board
from cell.cell import Cell
from recognition.gripper import Gripper
from recognition.model import Method
from service.calibration_runner import CalibrationRunner
from service.drift_watch import DriftWatch
from service.live import keep_recording
from service.new_rows import new_calibration, new_scan
from service.place import Place
from service.problems import ProblemError
from service.running import Running
from service.scan_runner import ScanRunner
from service.schemas import ScanState
from service.store import Store
from service.tables import CalibrationRow, RecordingRow, ScanRow
from service.worker import RecognitionWorker

log = logging.getLogger(__name__)

SETTLE_S = 5.0
"""Whoever stops a scan waits for its end so long. It takes milliseconds, but for a camera that is just being looked
for again."""

IDLE_CHECK_S = 1.0
"""While there is nothing to do, how often it is made sure that a recognition process waits."""


class Jobs:
    """Runs scans and calibrations. Every method may be called from any thread and may block for a moment."""

    def __init__(self, store: Store, cell: Cell, recognition_limit_s: float, gripper: Gripper) -> None:
        """Marks what an earlier service left unfinished as interrupted, keeps what earlier ones had recorded, and
        starts the recognition process."""
        self._store = store
        self._cell = cell
        self._worker = RecognitionWorker()
        self._place = Place()
        self.drift = DriftWatch(store.calibrations)
        """What recent scans tell of the calibration in use."""
        self._scans = ScanRunner(
            store, cell, self._worker, recognition_limit_s, gripper, self._place.leaving, self.drift
        )
        self._calibrations = CalibrationRunner(store, cell, self._place.leaving)
        self._accepted: queue.SimpleQueue[Running[Any] | None] = queue.SimpleQueue()
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
        running = self._place.close()
        if running is not None or self._cell.status.state == "busy":  # an arm at rest is let go, and no program ended
            again = (
                "start it again from its recording"
                if running and isinstance(running.row, ScanRow)
                else "start it again"
            )
            self._stop(running, "interrupted", f"the service was stopped; {again}")
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
            ProblemError: `cell-busy`, with the Location of what is under way.
        """
        with self._place.taken():
            scan = new_scan("replay", method, radius_m, recording.id)
            self._accept(Running(scan, None))
            return scan

    def submit_live(self, views: int | None, method: Method, radius_m: float | None) -> ScanRow:
        """Accepts a scan by the cell once the cell is ready and the scan is planned; on return it is on the disk.

        Takes seconds where the cell has to be connected first. Nothing moves before the scan is accepted.

        Raises:
            ProblemError: `cell-busy`, with the Location of what is under way.
            CellError: why the cell cannot do it.
        """
        with self._place.taken():
            plan = self._cell.prepare(views)
            scan = new_scan("live", method, radius_m, None)
            self._accept(Running(scan, plan))
            return scan

    def submit_calibration(self, board: Board, poses: int) -> CalibrationRow:
        """Accepts a calibration with the board on the table, as `submit_live` does a scan. Raises as that."""
        with self._place.taken():
            plan = self._cell.prepare_calibration(board, poses)
            row = new_calibration("calibration", board, poses, warnings=plan.warnings)
            self._accept(Running(row, plan))
            return row

    def submit_verification(self) -> CalibrationRow:
        """Accepts a look at the board, where it was left, from two poses. Raises as `submit_live`."""
        with self._place.taken():
            plan = self._cell.prepare_verification()
            hand_eye = self._cell.status.hand_eye  # loaded just now
            sha256 = None if hand_eye is None else hand_eye.sha256
            row = new_calibration("verification", None, len(plan.viewpoints), sha256)
            self._accept(Running(row, plan))
            return row

    @contextmanager
    def nothing_else(self) -> Iterator[None]:
        """A moment in which nothing is under way or begins.

        Raises:
            ProblemError: `cell-busy`, with the Location of what is under way.
        """
        with self._place.taken():
            yield

    def wait_for_preview(self, scan_id: str) -> None:
        """Returns when the picture of a scan that has a result is there, or will not be."""
        self._scans.wait_for_preview(scan_id)

    def cancel(self, row: ScanRow | CalibrationRow) -> None:
        """Stops it, the arm first, and waits until it has ended; it may have succeeded just before.

        Raises:
            ProblemError: `not-cancellable` when it had ended already, unless it was aborted.
        """
        running = self._place.running
        kind = "scan" if isinstance(row, ScanRow) else row.kind
        if running is not None and running.row.id == row.id:
            # The arm of a scan that has just ended may be at work for the next one.
            arm = running.plan is not None and not running.ended.is_set()
            self._stop(running, "aborted", f"the {kind} was cancelled", arm)
        elif row.state != "aborted":
            raise ProblemError(409, "not-cancellable", f"the {kind} is {row.state} already")

    def stop_arm(self) -> None:
        """Stops the arm, whatever goes on, and aborts the live scan or calibration under way, if any."""
        running = self._place.running
        live = running is not None and running.plan is not None
        self._stop(running if live else None, "aborted", "the arm was stopped by request")

    def release_arm(self) -> None:
        """Lets the arm go, once it is home.

        Raises:
            ProblemError: `cell-busy`, with the Location of what is under way.
            CellError: as `Cell.release`.
        """
        with self._place.taken():
            self._cell.release()

    @property
    def using_arm(self) -> str | None:
        """The live scan or calibration that is accepted and has not ended, if any, in words."""
        running = self._place.running
        return None if running is None or running.plan is None else running.words

    @property
    def calibration(self) -> str | None:
        """Id of the calibration or verification that is accepted and has not ended, if any."""
        running = self._place.running
        return running.row.id if running is not None and isinstance(running.row, CalibrationRow) else None

    def _accept(self, running: Running[Any]) -> None:
        """Writes the row of a scan or calibration for which the place is taken, and begins it."""
        add = self._store.add_scan if isinstance(running.row, ScanRow) else self._store.calibrations.add
        self._place.accept(running, lambda: add(running.row), lambda: self._accepted.put(running))

    def _stop(self, running: Running[Any] | None, state: ScanState, detail: str, arm: bool = True) -> None:
        """Stops the arm and what is under way, if anything is, and waits for its end."""
        # First the deed, then its record; the wish is only noted, so that a scan that the stop ends knows why.
        asked = running is not None and running.ask_to_stop(state, detail)
        if arm:
            self._cell.stop()
        if running is None:
            return
        of_scan = isinstance(running.row, ScanRow)
        if asked and of_scan and not running.ended.is_set():  # it could by now be at work on the next one
            self._worker.kill()
        try:
            if running.stop is not None:
                update = self._store.update_scan if of_scan else self._store.calibrations.update
                update(running.row.id, state="stopping")
        except sqlite3.OperationalError:
            log.exception("that %s is being stopped could not be written", running.words)
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
            runner = self._scans if isinstance(running.row, ScanRow) else self._calibrations
            runner.run(running)
            if self._accepted.empty():  # the next one, which may have been cancelled by now, does it if it must
                self._prepare()

    def _prepare(self) -> None:
        if not self._place.closed:
            self._worker.prepare()
