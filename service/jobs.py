"""One scan at a time: from its acceptance to its final state.

A thread of its own hands scans to the recognition process and writes down what becomes of them. There is no
queue: a cell has one arm, and whoever asks while it is busy is told so.
"""

import dataclasses
import errno
import logging
import queue
import shutil
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Literal

from cell.viewpoints import ViewpointPlan

from cell.cell import Cell
from cell.errors import CellError
from cell.recording_header import RecordingHeader
from recognition.gripper import Gripper
from recognition.model import Method
from service.live import keep_recording, live_outcome
from service.problems import ProblemError, cell_problem, problem_document
from service.running import Running
from service.schemas import ScanState
from service.store import Store, new_id, now
from service.tables import RecordingRow, ScanRow
from service.worker import RecognitionWorker, TaskFailedError
from service.worker_process import Task
from service.workflow import DONE_BEFORE, OnStage, Outcome

log = logging.getLogger(__name__)

SETTLE_S = 5.0
"""A cancelled scan ends within this time; its process is killed, which takes milliseconds."""

IDLE_CHECK_S = 1.0
"""While there is nothing to do, how often it is made sure that a recognition process waits."""


class Jobs:
    """Runs scans. Every method may be called from any thread and may block for a moment."""

    def __init__(self, store: Store, cell: Cell, recognition_limit_s: float, gripper: Gripper) -> None:
        """Marks what an earlier service left unfinished as interrupted, keeping what it had recorded; starts the
        recognition process."""
        self._store = store
        self._cell = cell
        self._limit_s = recognition_limit_s
        self._gripper = gripper
        self._worker = RecognitionWorker()
        self._turn = threading.Lock()
        """Of taking and leaving the one place, each together with its row: whoever reads that a scan has
        ended finds the place free."""
        self._running: Running | None = None
        self._preparing = False
        """The place is taken for a live scan that is not accepted yet."""
        self._closing = False
        self._accepted: queue.SimpleQueue[Running | None] = queue.SimpleQueue()
        for interrupted in store.interrupt_unfinished():
            keep_recording(store, interrupted.id)
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops the scan under way, if any (it becomes `interrupted`), and ends the recognition process."""
        with self._turn:
            self._closing = True
            running = self._running
        if running is not None:
            self._stop(running, "interrupted", "the service was stopped; start it again from its recording")
        else:
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

    def cancel(self, scan: ScanRow) -> None:
        """Stops a scan, the arm first, and waits until it has ended; it may have succeeded just before.

        Raises:
            ProblemError: `not-cancellable` when it had ended already, unless it was aborted.
        """
        running = self._running
        if running is not None and running.scan.id == scan.id:
            self._stop(running, "aborted", "the scan was cancelled")
        elif scan.state != "aborted":
            raise ProblemError(409, "not-cancellable", f"the scan is {scan.state} already")

    def stop_arm(self) -> None:
        """Stops the arm, whatever goes on, and aborts the live scan under way, if any."""
        self._cell.stop()
        running = self._running
        if running is not None and running.plan is not None:
            self._stop(running, "aborted", "the arm was stopped by request")

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

    def _stop(self, running: Running, state: ScanState, detail: str) -> None:
        # First the deed, then its record.
        if running.plan is not None and not running.ended.is_set():
            self._cell.stop()
        if running.ask_to_stop(state, detail):
            self._worker.kill()
        if running.stop is not None:
            self._store.update_scan(running.scan.id, state="stopping")
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
            try:
                self._process(running)
            except Exception:  # whatever it is, this scan is told as failed and the next one is taken
                log.exception("scan %s could not be recorded", running.scan.id)
                self._give_up(running)
            running.ended.set()
            self._prepare()

    def _prepare(self) -> None:
        if not self._closing:
            self._worker.prepare()

    def _process(self, running: Running) -> None:
        results = self._store.folder.incoming(running.scan.id)
        try:
            with ExitStack() as until_home:
                outcome, problem = self._try(running, results, until_home)
                try:
                    self._record(running, outcome, problem, results)
                finally:
                    shutil.rmtree(results, ignore_errors=True)
                    running.ended.set()
        except CellError as error:
            log.warning("behind scan %s the arm did not get home: %s", running.scan.id, error)

    def _try(
        self, running: Running, results: Path, until_home: ExitStack
    ) -> tuple[Outcome | None, dict[str, Any] | None]:
        """What the scan gives, or the problem why it gives nothing; neither when it was stopped before it began."""
        try:
            if running.stop is None:
                self._worker.start()
            # A stop that came before found no process to kill; one that comes from here on does.
            if running.stop is None:
                return self._outcome(running, results, until_home), None
        except TaskFailedError as error:
            return None, error.problem
        except CellError as error:
            return None, cell_problem(error)
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            detail = "no space is left in the data folder; what was recorded before is kept"
            return None, problem_document(507, "storage-full", detail)
        return None, None

    def _outcome(self, running: Running, results: Path, until_home: ExitStack) -> Outcome:
        """What the scan gives; a live one's arm is home when `until_home` is left."""
        scan, store, plan = running.scan, self._store, running.plan
        if plan is None:
            recording = store.recording(scan.recording or "")
            assert recording is not None
            task = self._task(scan, store.folder.recording(recording.id), results)
            store.update_scan(scan.id, ("queued",), state="processing", started_at=now())
            outcome = self._worker.run(task, self._progress(scan.id), self._limit_s)
            return dataclasses.replace(outcome, partial=outcome.partial or bool(recording.missing))
        store.update_scan(scan.id, ("queued",), state="scanning", started_at=now())
        task = self._task(scan, self._cell.header(scan.string_radius_m), results)
        live = live_outcome(scan, plan, self._cell, store, self._worker, task, self._limit_s)
        return until_home.enter_context(live)

    def _task(self, scan: ScanRow, source: Path | RecordingHeader, results: Path) -> Task:
        return Task(source, scan.string_radius_m, scan.method, self._gripper, results)

    def _record(self, running: Running, outcome: Outcome | None, problem: dict[str, Any] | None, results: Path) -> None:
        scan, store, stop = running.scan, self._store, running.begin_storing()
        with self._turn:
            if stop is not None:
                state, detail = stop
                stopped = problem_document(409, state, detail)
                store.update_scan(scan.id, state=state, problem=stopped, ended_at=now())
            elif outcome is not None:
                state = "partial" if outcome.partial else "succeeded"
                store.finish_scan(scan.id, state, dataclasses.asdict(outcome), results)
            else:
                log.warning("scan %s failed: %s", scan.id, problem)
                store.update_scan(scan.id, state="failed", problem=problem, ended_at=now())
            self._running = None

    def _give_up(self, running: Running) -> None:
        """The disk or the database failed. If this cannot be written either, the next start mends the row."""
        problem = problem_document(500, "internal", "the result could not be stored; the log has the reason")
        with self._turn:
            try:
                self._store.update_scan(running.scan.id, state="failed", problem=problem, ended_at=now())
            except sqlite3.Error:
                log.exception("nor could this be written of scan %s", running.scan.id)
            if self._running is running:
                self._running = None

    def _progress(self, scan_id: str) -> OnStage:
        def on_stage(name: str) -> None:
            self._store.update_scan(scan_id, ("queued", "processing"), stage=name, fraction=DONE_BEFORE[name])

        return on_stage
