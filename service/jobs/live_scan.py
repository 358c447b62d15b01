"""A scan by the cell: the arm moves, each view goes to disk and to recognition, and the result joins the recording."""

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from cell.control.background_scan import BackgroundScan
from cell.control.cell import Cell
from cell.control.prepared import PreparedScan
from cell.control.scan_loop import missing_view
from cell.devices import View
from cell.recording.writer import RecordingEmptyError, RecordingError, RecordingWriter
from service.jobs.inputs import recognition_inputs
from service.metrics.scans import ScanMetrics
from service.processing.recording_metadata import describe_recording
from service.processing.results import Outcome
from service.processing.worker import RecognitionWorker, TaskFailedError
from service.processing.worker_main import Task
from service.storage.data_folder import MODEL
from service.storage.rows import ScanRow
from service.storage.store import Store

log = logging.getLogger(__name__)

SCANNING_SHARE = 0.95
"""Of a live scan's time, the views take so much."""


class StoredProgress:
    """Writes down how a scan goes: the intent before each move, and what became of each view."""

    def __init__(self, store: Store, scan_id: str, views: int, writer: RecordingWriter, metrics: ScanMetrics) -> None:
        self.reasons: list[str] = []
        """Which views are missing, and why; they become warnings of the model."""
        self._store, self._scan_id, self._views, self._done = store, scan_id, views, 0
        self._writer, self._metrics = writer, metrics
        self._on_its_way: int | None = None

    def moving(self, index: int) -> None:
        """The arm moves when this is on the disk."""
        self._on_its_way = index
        self._store.set_view(self._scan_id, index, "moving")

    def recorded(self, index: int) -> None:
        """The view itself is on the disk; which bytes it is there is kept with it."""
        self._store.set_view(self._scan_id, index, "recorded", written=self._writer.written(index))
        self._metrics.recorded()
        self._advance()

    def missing(self, index: int, reason: str) -> None:
        """There is no such view."""
        self.reasons.append(missing_view(index, reason))
        self._store.set_view(self._scan_id, index, "missing", reason)
        # One that the arm was not even sent to cannot be reached.
        self._metrics.missing("camera" if index == self._on_its_way else "unreachable")
        self._advance()

    def _advance(self) -> None:
        self._done += 1
        fraction = round(SCANNING_SHARE * self._done / self._views, 3)
        self._store.update_scan(self._scan_id, ("scanning",), stage="views", fraction=fraction)


@contextmanager
def live_outcome(
    scan: ScanRow,
    prepared: PreparedScan,
    cell: Cell,
    store: Store,
    worker: RecognitionWorker,
    task: Task,
    limit_s: float,
    metrics: ScanMetrics,
) -> Iterator[Outcome]:
    """Takes the views, recognises them and gives the outcome; the recording is in the store by then.

    The body runs while the arm goes home, which is waited for at its end. When this ends by an error, the views that
    were taken are in the store as a recording.

    Raises:
        CellError: the scan could not be done, or the arm did not get home.
        TaskFailedError: recognition gave no result. All views were taken nevertheless, and the arm is home.
        OSError, sqlite3.Error: the disk.
    """
    path = store.folder.recording(scan.id)
    assert not isinstance(task.source, Path)
    try:
        with RecordingWriter(path, task.source) as writer:
            progress = StoredProgress(store, scan.id, len(prepared.plan.viewpoints), writer, metrics)
            with cell.run(prepared, writer, progress) as views:
                outcome = _recognise(store, scan.id, worker, task, limit_s, views, progress)
                try:
                    writer.write_result(json.loads((task.results / MODEL).read_bytes()))
                    writer.close()
                    keep_recording(store, scan.id)
                except BaseException:
                    worker.kill()  # nobody will see the picture that it is drawing
                    raise
                yield outcome
    finally:
        keep_recording(store, scan.id)


def _recognise(
    store: Store,
    scan_id: str,
    worker: RecognitionWorker,
    task: Task,
    limit_s: float,
    views: BackgroundScan,
    progress: StoredProgress,
) -> Outcome:
    def until_last() -> Iterator[View]:
        yield from views
        inputs = recognition_inputs(task, views=store.views([scan_id]))
        store.update_scan(scan_id, ("scanning",), state="processing", inputs=inputs)

    def on_stage(name: str) -> None:
        # Those of views that come in while others are still to be taken are no news.
        store.update_scan(scan_id, ("processing",), stage=name)

    try:
        outcome = worker.run(task, on_stage, limit_s, until_last(), progress.reasons)
    except TaskFailedError:
        for _ in views:
            pass  # the recording is worth having
        views.wait()  # nor need the arm stop on its way home
        raise
    return replace(outcome, partial=outcome.partial or bool(progress.reasons))


def keep_recording(store: Store, scan_id: str) -> None:
    """Takes what a live scan has recorded into the store, if it is not there yet; one without a view is removed.

    What is missing from it is told with it, so that no replay is taken for one of all views.
    """
    path = store.folder.recording(scan_id)
    if not path.exists() or store.recording(scan_id) is not None:
        return
    try:
        row = describe_recording(scan_id, path)
    except RecordingEmptyError:
        path.unlink()
        return
    except RecordingError:
        log.exception("the recording %s cannot be read; it stays where it is", path)
        return
    missing = [missing_view(view.view, view.reason or "") for view in store.views([scan_id]) if view.state == "missing"]
    store.add_scan_recording(replace(row, missing=[*missing, *row.missing]))
