"""One live scan by the configured cell, without a server: `pointchain scan`."""

import json
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cell.config.cell_config import CellSettings
from cell.control.cell import Cell
from cell.control.scan_loop import missing_view
from cell.errors import StoppedError
from cell.planning.viewpoints import ViewpointPlan
from cell.recording.errors import RecordingEmptyError
from cell.recording.writer import RecordingExistsError, RecordingWriter, read_recording
from recognition.grasping.gripper import Gripper
from recognition.model.model import SCHEMA, Method
from service.cli.robot_task import EndedEarlyError, with_moving_cell
from service.config.sections import LimitsConfig
from service.processing.results import check_radius
from service.processing.worker import RecognitionWorker
from service.processing.worker_main import Task
from service.signals import STOPPED_CODE
from service.storage.data_folder import MODEL, PREVIEW

Say = Callable[[str], None]


class ToldProgress:
    """Tells a person how a scan goes, and lets no move begin once a stop was asked for."""

    def __init__(self, plan: ViewpointPlan, say: Say, stop_asked: threading.Event) -> None:
        self.reasons: list[str] = []
        """Which views are missing, and why; they become warnings of the model."""
        self._say, self._stop_asked = say, stop_asked
        self._views, self._taken = len(plan.viewpoints), 0

    def moving(self, index: int) -> None:
        """The arm is about to move. Raises StoppedError."""
        if self._stop_asked.is_set():  # before the cell was at work, so that it knows of none
            raise StoppedError("stopped by request")
        self._say(f"moving to viewpoint {index}")

    def recorded(self, index: int) -> None:
        """The view is on the disk."""
        self._taken += 1
        self._say(f"view {index} recorded, {self._taken} of {self._views}")

    def missing(self, index: int, reason: str) -> None:
        """There is no such view."""
        self.reasons.append(missing_view(index, reason))
        self._say(self.reasons[-1])


@dataclass(frozen=True)
class Wanted:
    """One scan, as somebody asks for it."""

    recording: Path | None = None
    """A new file; None: not kept."""
    radius_m: float | None = None
    """Of the string; None: as configured, or estimated."""
    method: Method = "graph"
    views: int | None = None
    """None: as many as configured."""
    gripper: Gripper = field(default_factory=Gripper)
    limit_s: float = LimitsConfig().recognition_s
    """Recognition may take so long after the last view."""


def take_scan(
    cell: Cell, worker: RecognitionWorker, wanted: Wanted, say: Say, stop_asked: threading.Event
) -> dict[str, Any]:
    """A scan by `cell`; connects first if need be. The arm is home on return.

    Gives the model as JSON. Recognition has a process of its own, of `worker`: in this one it would keep the arm
    waiting for its watchdog. Whoever wants it ended sets `stop_asked`, stops the cell and kills the worker, from
    another thread; the views taken stay in the file.

    Raises:
        CellError: the scan cannot be done, or ended early.
        TaskFailedError: recognition gave no result; all views are in the file.
        RecordingError, OSError: the file cannot be written.
        RecognitionError: the radius cannot be used.
    """
    radius, kept = check_radius(wanted.radius_m, cell.settings.scan.string_radius_m), wanted.recording
    if kept is not None and kept.exists():
        raise RecordingExistsError(f"{kept} exists already; recordings are never overwritten")
    say("connecting, planning")
    with ThreadPoolExecutor(1) as pool:  # left when the process has started, or ended
        started = pool.submit(worker.start)
        try:
            prepared = cell.prepare_scan(wanted.views, time.monotonic())
            started.result()
        except BaseException:
            worker.kill()
            raise
    with TemporaryDirectory(prefix="pointchain-") as folder:
        told = ToldProgress(prepared.plan, say, stop_asked)
        header = replace(prepared.header, string_radius_m=radius)
        results = Path(folder) / "results"
        task = Task(header, radius, wanted.method, wanted.gripper, results, Path(folder) / PREVIEW)
        with (
            RecordingWriter(kept or Path(folder) / "scan.mcap", header) as writer,
            cell.run(prepared, writer, told) as taken,
        ):
            worker.run(task, lambda _: None, wanted.limit_s, taken, told.reasons)
            model = json.loads((results / MODEL).read_bytes())
            writer.write_result(model)
    return model


def scan_once(settings: CellSettings, wanted: Wanted) -> int:
    """One scan; its model as one line of JSON on stdout, or `{"schema", "error"}`.

    0 when there is a model, 130 after Ctrl-C or SIGTERM, which stop the arm, else 1.
    """
    with closing(RecognitionWorker()) as worker:
        try:
            document = with_moving_cell(
                settings,
                lambda cell, stop: take_scan(cell, worker, wanted, _say, stop),
                wanted.recording or "the recording",
                worker.kill,
            )
            code = 0
        except EndedEarlyError as error:
            problem, code = error.problem, error.code
            if code == STOPPED_CODE and wanted.recording and wanted.recording.exists():
                problem["detail"] += _kept(wanted.recording)
            document = {"schema": SCHEMA, "error": problem}
    print(json.dumps(document, allow_nan=False), flush=True)
    if code != 0:
        _say(document["error"]["detail"])
        return code
    _say(f"chains: {len(document['chains'])}, crossings: {len(document['crossings'])}")
    for told in (*document["quality"]["ambiguities"], *document["quality"]["warnings"]):
        _say(told)
    return code


def _kept(recording: Path) -> str:
    """What there is of a scan that was stopped; a recording without any view is removed, so that its name is free."""
    try:
        count = len(read_recording(recording).views)
    except RecordingEmptyError:
        recording.unlink()
        return "; no view had been taken"
    return f"; the views taken until then are in {recording}: {count}"


def _say(words: str) -> None:
    print(f"pointchain scan: {words}", file=sys.stderr)
