"""One scan at a time: from its acceptance to its final state.

A thread of its own hands scans to the recognition process and writes down what becomes of them. There is no
queue: a cell has one arm, and whoever asks while it is busy is told so.
"""

import dataclasses
import logging
import queue
import shutil
import sqlite3
import threading
from collections.abc import Callable

from recognition.gripper import Gripper
from recognition.model import Method
from service.problems import ProblemError, problem_document
from service.schemas import ScanState
from service.store import RecordingRow, ScanRow, Store, new_id, now
from service.worker import RecognitionWorker, Task, TaskFailedError
from service.workflow import DONE_BEFORE

log = logging.getLogger(__name__)

SETTLE_S = 5.0
"""A cancelled scan ends within this time; its process is killed, which takes milliseconds."""

IDLE_CHECK_S = 1.0
"""While there is nothing to do, how often it is made sure that a recognition process waits."""


class _Running:
    """The scan under way."""

    def __init__(self, scan: ScanRow) -> None:
        self.scan = scan
        self.ended = threading.Event()
        self.stop: tuple[ScanState, str] | None = None
        """State to end in, and why, once somebody wants it stopped."""
        self.storing = False
        """Past the point where it can be stopped."""


class Jobs:
    """Runs scans. Every method may be called from any thread and may block for a moment."""

    def __init__(self, store: Store, recognition_limit_s: float, gripper: Gripper) -> None:
        """Marks what an earlier service left unfinished as interrupted; starts the recognition process."""
        self._store = store
        self._limit_s = recognition_limit_s
        self._gripper = gripper
        self._worker = RecognitionWorker()
        self._lock = threading.Lock()
        """Of the wish to stop; never held while something is written."""
        self._turn = threading.Lock()
        """Of taking and leaving the one place, each together with its row: whoever reads that a scan has
        ended finds the place free."""
        self._running: _Running | None = None
        self._closing = False
        self._not_ready: str | None = "recognition is starting"
        self._accepted: queue.SimpleQueue[_Running | None] = queue.SimpleQueue()
        store.interrupt_unfinished()
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
        if self._not_ready is None and not self._worker.alive:
            return "recognition is starting again"
        return self._not_ready

    def submit_replay(self, recording: RecordingRow, method: Method, radius_m: float | None) -> ScanRow:
        """Accepts a scan from a recording; on return it is on the disk.

        Raises:
            ProblemError: `cell-busy`, with the Location of the scan under way.
        """
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
            scan = ScanRow(
                id=new_id(),
                mode="replay",
                recording=recording.id,
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
            self._store.add_scan(scan)
            self._running = _Running(scan)
            self._accepted.put(self._running)
        return scan

    def cancel(self, scan: ScanRow) -> None:
        """Stops a scan and waits until it has ended; it may have succeeded just before.

        Raises:
            ProblemError: `not-cancellable` when it had ended already, unless it was aborted.
        """
        running = self._running
        if running is not None and running.scan.id == scan.id:
            self._stop(running, "aborted", "the scan was cancelled")
        elif scan.state != "aborted":
            raise ProblemError(409, "not-cancellable", f"the scan is {scan.state} already")

    def _stop(self, running: _Running, state: ScanState, detail: str) -> None:
        with self._lock:
            if not running.storing and running.stop is None:
                running.stop = (state, detail)
                # First the deed, then its record.
                self._worker.kill()
        if running.stop is not None:
            self._store.update_scan(running.scan.id, ("queued", "processing"), state="stopping")
        running.ended.wait(SETTLE_S)

    def _work(self) -> None:
        self._prepare()
        while True:
            try:
                running = self._accepted.get(timeout=IDLE_CHECK_S)
            except queue.Empty:
                if self._not_ready is None:  # it has worked before: should it have died, have a new one ready
                    self._prepare()
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
        if self._closing:
            return
        if not self._worker.alive:
            self._not_ready = "recognition is starting"
        try:
            self._worker.start()
            self._not_ready = None
        except TaskFailedError as error:
            # Killed by a cancel while it started, or broken: the next scan tries again and tells.
            self._not_ready = f"recognition did not start: {error}"

    def _process(self, running: _Running) -> None:
        scan, store = running.scan, self._store
        recording = store.recording(scan.recording or "")
        assert recording is not None
        results = store.folder.incoming(scan.id)
        task = Task(store.folder.recording(recording.id), scan.string_radius_m, scan.method, self._gripper, results)
        outcome, problem = None, None
        try:
            if running.stop is None:
                self._worker.start()
            # A stop that came before found no process to kill; one that comes from here on does.
            if running.stop is None:
                store.update_scan(scan.id, ("queued",), state="processing", started_at=now())
                outcome = self._worker.run(task, self._progress(scan.id), self._limit_s)
        except TaskFailedError as error:
            problem = error.problem
        with self._lock:
            running.storing, stop = True, running.stop
        try:
            with self._turn:
                if stop is not None:
                    state, detail = stop
                    stopped = problem_document(409, state, detail)
                    store.update_scan(scan.id, state=state, problem=stopped, ended_at=now())
                elif outcome is not None:
                    state = "partial" if outcome.partial or recording.missing else "succeeded"
                    store.finish_scan(scan.id, state, dataclasses.asdict(outcome), results)
                else:
                    log.warning("scan %s failed: %s", scan.id, problem)
                    store.update_scan(scan.id, state="failed", problem=problem, ended_at=now())
                self._running = None
        finally:
            shutil.rmtree(results, ignore_errors=True)

    def _give_up(self, running: _Running) -> None:
        """The disk or the database failed. If this cannot be written either, the next start mends the row."""
        problem = problem_document(500, "internal", "the result could not be stored; the log has the reason")
        with self._turn:
            try:
                self._store.update_scan(running.scan.id, state="failed", problem=problem, ended_at=now())
            except sqlite3.Error:
                log.exception("nor could this be written of scan %s", running.scan.id)
            self._running = None

    def _progress(self, scan_id: str) -> Callable[[str], None]:
        def on_stage(name: str) -> None:
            self._store.update_scan(scan_id, ("queued", "processing"), stage=name, fraction=DONE_BEFORE[name])

        return on_stage
