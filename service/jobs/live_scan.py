"""A live scan: views go to the recording and to recognition as they are taken, and the result joins the recording."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from cell.control.background_scan import BackgroundScan
from cell.control.cell import Cell
from cell.control.prepared import PreparedScan
from cell.control.progress import MissingView
from cell.devices import View
from cell.recording import RecordingEmptyError, RecordingError, RecordingWriter
from recognition.early_end.view_sufficiency import ViewCheck
from service.jobs.inputs import recognition_inputs
from service.jobs.progress import StoredProgress
from service.metrics.scans import ScanMetrics
from service.processing.recording_metadata import describe_recording
from service.processing.results import Outcome, write_model
from service.processing.worker import OnCheck, RecognitionWorker, TaskFailedError
from service.processing.worker_main import Task
from service.storage.rows import ScanRow
from service.storage.store import Store

log = logging.getLogger(__name__)


@contextmanager
def run_live_scan(
    scan: ScanRow,
    prepared: PreparedScan,
    cell: Cell,
    store: Store,
    worker: RecognitionWorker,
    task: Task,
    limit_s: float,
    metrics: ScanMetrics,
    on_more_views: Callable[[], None],
) -> Iterator[Outcome]:
    """Take the views, recognise them, and store the recording. Yields the result.

    `on_more_views` is called if the scan might have ended early but goes on. The body runs while the arm returns home;
    the end of the context waits for that. If an error ends the scan, the views taken so far are in the store as a
    recording.

    Raises:
        CellError: The views could not be taken, or the arm did not return home.
        TaskFailedError: Recognition gave no result. All views were taken all the same, and the arm is home.
        OSError, sqlite3.Error: The disk or the database failed.
    """
    path = store.folder.recording(scan.id)
    assert not isinstance(task.source, Path)
    try:
        with RecordingWriter(path, task.source) as writer:
            progress = StoredProgress(store, scan, len(prepared.plan.viewpoints), writer, metrics)
            with cell.run(prepared, writer, progress) as views:
                on_check = partial(_decide, views, prepared.may_end_after, on_more_views)
                outcome = _recognise(store, scan.id, worker, task, limit_s, views, on_check)
                try:
                    writer.write_result(outcome.model)
                    writer.close()
                    keep_recording(store, scan.id)
                    recording = store.recording(scan.id)
                    sha256 = None if recording is None else recording.sha256
                    outcome = write_model(outcome, task.results, sha256)
                except BaseException:
                    worker.kill()  # its preview is of no use any more
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
    on_check: OnCheck,
) -> Outcome:
    def all_views() -> Iterator[View]:
        yield from views
        inputs = recognition_inputs(views=store.scans.views([scan_id]))
        store.scans.update(scan_id, ("scanning",), state="processing", inputs=inputs)

    def on_stage(name: str) -> None:
        # While views are still being taken, the stages of the earlier ones are not reported.
        store.scans.update(scan_id, ("processing",), stage=name)

    try:
        outcome = worker.run(task, on_stage, limit_s, all_views(), views.missing, on_check, views.next_is_here)
    except TaskFailedError:
        views.early_end.close()
        for _ in views:
            pass  # take the remaining views for the recording
        views.wait()  # and let the arm return home
        raise
    return replace(outcome, partial=outcome.partial or bool(views.missing))


def _decide(
    views: BackgroundScan, may_end_after: int | None, on_more_views: Callable[[], None], check: ViewCheck
) -> None:
    log.info("after %d views: %s", check.views, "; ".join(check.doubts) or "nothing is doubtful")
    views.early_end.decide(check.views, check.suffices)
    if check.views == may_end_after and not check.suffices:
        on_more_views()


def keep_recording(store: Store, scan_id: str) -> None:
    """Add the recording of a live scan to the store, if it is not there yet. A recording without a view is removed.

    Its row lists the missing views, so that a replay reports them.

    Raises:
        OSError: The file cannot be read.
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
        log.exception("the recording %s cannot be read; the file is left in place", path)
        return
    missing = [view for view in store.scans.views([scan_id]) if view.state == "missing"]
    messages = [MissingView(view.view, view.reason or "").message for view in missing]
    store.add_scan_recording(replace(row, missing=[*messages, *row.missing]))
