"""`pointchain scan`: one live scan by the configured cell, without a server."""

import json
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cell.config.cell_config import CellSettings
from cell.config.scan_views import Views
from cell.control.background_scan import BackgroundScan
from cell.control.cell import Cell
from cell.recording import RecordingExistsError, RecordingWriter, read_recording
from cell.recording.errors import RecordingEmptyError
from recognition.early_end.view_sufficiency import ViewCheck
from recognition.model.model import SCHEMA
from recognition.request import RecognitionRequest
from service.cli.progress import Report, TerminalProgress
from service.cli.robot_task import EndedEarlyError, run_with_cell
from service.config.sections import LimitsConfig
from service.processing.recording_metadata import hash_file
from service.processing.results import with_recording_hash
from service.processing.worker import RecognitionWorker
from service.processing.worker_main import Task
from service.signals import INTERRUPTED_EXIT_CODE
from service.storage.data_folder import PREVIEW


@dataclass(frozen=True)
class ScanOptions:
    """Options of one scan."""

    recording: Path | None = None
    """New file for the recording. None: it is not kept."""
    request: RecognitionRequest = field(default_factory=RecognitionRequest)
    """How to recognise the views. Without a radius, the configured one is used, or else it is measured."""
    views: Views | None = None
    """Number of viewpoints or `auto`. None: the configured value."""
    timeout_s: float = LimitsConfig().recognition_s
    """Timeout of the recognition after the last view."""


def take_scan(
    cell: Cell, worker: RecognitionWorker, options: ScanOptions, report: Report, stop_requested: threading.Event
) -> dict[str, Any]:
    """Scan with a cell, and connect it first if needed. The arm is home when this returns.

    Recognition runs in the process of `worker`: in this process it would delay the watchdog signals of the arm. To end
    the scan, another thread sets `stop_requested`, stops the cell and kills the worker. The views taken until then stay
    in the file.

    Args:
        cell: The cell.
        worker: Process for the recognition.
        options: Options of the scan.
        report: Receives the progress messages.
        stop_requested: Event that prevents the next move.

    Returns:
        The model as JSON values.

    Raises:
        CellError: The scan cannot be started, or ended early.
        TaskFailedError: Recognition gave no result. All views are in the file.
        RecordingError: The file exists, or cannot be written.
        OSError: The file cannot be written.
        RecognitionError: The radius cannot be used.
    """
    request = options.request.or_radius(cell.settings.scan.string_radius_m)
    recording = options.recording
    if recording is not None and recording.exists():
        raise RecordingExistsError(f"{recording} exists already; recordings are never overwritten")
    report("connecting, planning")
    with ThreadPoolExecutor(1) as pool:  # the block ends when the process has started or ended
        started = pool.submit(worker.start)
        try:
            prepared = cell.prepare_scan(options.views, time.monotonic())
            started.result()
        except BaseException:
            worker.kill()
            raise
    with TemporaryDirectory(prefix="pointchain-") as folder:
        progress = TerminalProgress(prepared, report, stop_requested)
        header = replace(prepared.header, string_radius_m=request.radius_m)
        results = Path(folder) / "results"
        preview = Path(folder) / PREVIEW
        task = Task(
            header,
            request,
            results,
            preview,
            check_views=prepared.may_end_after is not None,
        )
        with (
            RecordingWriter(recording or Path(folder) / "scan.mcap", header) as writer,
            cell.run(prepared, writer, progress) as views,
        ):
            on_check = partial(_decide, views, report)
            outcome = worker.run(
                task, lambda _: None, options.timeout_s, views, views.missing, on_check, views.next_is_here
            )
            writer.write_result(outcome.model)
    sha256 = None if recording is None else hash_file(recording)
    return with_recording_hash(outcome.model, sha256)


def _decide(views: BackgroundScan, report: Report, check: ViewCheck) -> None:
    views.early_end.decide(check.views, check.suffices)
    if check.suffices:
        report(f"{check.views} views suffice")


def run_scan(settings: CellSettings, options: ScanOptions) -> int:
    """Scan, and print the model to stdout as one line of JSON, or a document with `schema` and `error`.

    Returns:
        The exit code: 0 with a model, 130 after Ctrl-C or SIGTERM, which stop the arm, else 1.
    """
    with closing(RecognitionWorker()) as worker:
        try:
            document = run_with_cell(
                settings,
                lambda cell, stop: take_scan(cell, worker, options, _report, stop),
                options.recording or "the recording",
                worker.kill,
            )
            code = 0
        except EndedEarlyError as error:
            problem, code = error.problem, error.code
            if code == INTERRUPTED_EXIT_CODE and options.recording and options.recording.exists():
                problem["detail"] += _describe_recording(options.recording)
            document = {"schema": SCHEMA, "error": problem}
    print(json.dumps(document, allow_nan=False), flush=True)
    if code != 0:
        _report(document["error"]["detail"])
        return code
    quality = document["quality"]
    _report(
        f"chains: {len(document['chains'])}, crossings: {len(document['crossings'])}, verdict: {quality['verdict']}"
    )
    for found in quality["findings"]:
        _report(f"{found['severity']}: {found['message']} [{found['code']}]")
    return code


def _describe_recording(recording: Path) -> str:
    """Describe the recording of a stopped scan. Remove a recording without views, so that its name is free again."""
    try:
        count = len(read_recording(recording).views)
    except RecordingEmptyError:
        recording.unlink()
        return "; no view had been taken"
    return f"; the views taken until then are in {recording}: {count}"


def _report(message: str) -> None:
    print(f"pointchain scan: {message}", file=sys.stderr)
