"""One live scan by the configured cell, without a server: `pointchain scan`."""

import json
import signal
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cell.cell import Cell
from cell.errors import CellError
from cell.recording import RecordingExistsError, RecordingWriter
from cell.scan import missing_view
from cell.viewpoints import ViewpointPlan
from recognition.gripper import Gripper
from recognition.model import SCHEMA, Method
from service.config import ServiceConfig
from service.data_folder import MODEL, PREVIEW
from service.problems import INPUT_ERRORS, cell_problem, problem_document
from service.worker import RecognitionWorker, TaskFailedError
from service.worker_process import Task
from service.workflow import check_radius

Say = Callable[[str], None]
STOPPED_CODE = 130
"""As a shell has it for what Ctrl-C ended."""


class ToldProgress:
    """Tells a person how a scan goes."""

    def __init__(self, plan: ViewpointPlan, say: Say) -> None:
        self.reasons: list[str] = []
        """Which views are missing, and why; they become warnings of the model."""
        self._say, self._views, self._taken = say, len(plan.viewpoints), 0

    def moving(self, index: int) -> None:
        """The arm is about to move."""
        self._say(f"moving to viewpoint {index}")

    def recorded(self, index: int) -> None:
        """The view is on the disk."""
        self._taken += 1
        self._say(f"view {index} recorded, {self._taken} of {self._views}")

    def missing(self, index: int, reason: str) -> None:
        """There is no such view."""
        self.reasons.append(missing_view(index, reason))
        self._say(self.reasons[-1])


def take_scan(
    cell: Cell,
    recording: Path,
    radius_m: float | None,
    method: Method,
    gripper: Gripper,
    limit_s: float,
    say: Say,
    views: int | None = None,
) -> dict[str, Any]:
    """A scan by `cell` into the new file `recording`; connects first if need be. The arm is home on return.

    Recognition may take `limit_s`.

    Gives the model as JSON. Recognition has a process of its own: in this one it would keep the arm waiting for its
    watchdog. Interrupted by an exception (a KeyboardInterrupt too), the arm is stopped first; the views taken stay in
    the file.

    Raises:
        CellError: the scan cannot be done, or ended early.
        TaskFailedError: recognition gave no result; all views are in the file.
        RecordingError, OSError: the file cannot be written.
        RecognitionError: the radius cannot be used.
    """
    radius = check_radius(radius_m, cell.settings.scan.string_radius_m)
    if recording.exists():
        raise RecordingExistsError(f"{recording} exists already; recordings are never overwritten")
    say("connecting, planning")
    with closing(RecognitionWorker()) as worker, TemporaryDirectory(prefix="pointchain-") as folder:
        with ThreadPoolExecutor(1) as pool:  # left when the process has started, or ended
            started = pool.submit(worker.start)
            try:
                plan = cell.prepare(views)
                started.result()
            except BaseException:
                worker.kill()
                raise
        told, header = ToldProgress(plan, say), cell.header(radius)
        results = Path(folder) / "results"
        task = Task(header, radius, method, gripper, results, Path(folder) / PREVIEW)
        with RecordingWriter(recording, header) as writer, cell.scanning(plan, writer, told) as taken:
            worker.run(task, lambda _: None, limit_s, taken, told.reasons)
            model = json.loads((results / MODEL).read_bytes())
            writer.write_result(model)
    return model


def scan_once(
    config: ServiceConfig, recording: Path | None, radius_m: float | None, method: Method, views: int | None
) -> int:
    """One scan; its model as one line of JSON on stdout, or `{"schema", "error"}`.

    0 when there is a model, 130 after Ctrl-C or SIGTERM, which stop the arm, else 1.
    """

    def say(words: str) -> None:
        print(f"pointchain scan: {words}", file=sys.stderr)

    cell, problem, code = Cell(config.cell), {}, 0
    document: dict[str, Any] = {}
    _interrupted_by_signals()
    try:
        with TemporaryDirectory(prefix="pointchain-") as folder:
            path = recording or Path(folder) / "scan.mcap"
            document = take_scan(
                cell, path, radius_m, method, config.gripper.value, config.limits.recognition_s, say, views
            )
    except KeyboardInterrupt:
        kept = f"; the views taken until then are in {recording}" if recording and recording.exists() else ""
        problem, code = problem_document(409, "stopped", f"stopped by request{kept}"), STOPPED_CODE
    except TaskFailedError as error:
        problem, code = error.problem, 1
    except CellError as error:
        problem, code = cell_problem(error), 1
    except INPUT_ERRORS as error:
        problem, code = problem_document(422, error.slug, str(error)), 1
    except OSError as error:
        reason = f"{recording or 'the recording'} cannot be written: {error.strerror or error}"
        problem, code = problem_document(507, "file", reason), 1
    finally:
        cell.close()
    if problem:
        document = {"schema": SCHEMA, "error": problem}
        say(problem["detail"])
    else:
        say(f"chains: {len(document['chains'])}, crossings: {len(document['crossings'])}")
        for told in (*document["quality"]["ambiguities"], *document["quality"]["warnings"]):
            say(told)
    print(json.dumps(document, allow_nan=False), flush=True)
    return code


def _interrupted_by_signals() -> None:
    """SIGTERM, and SIGINT also where a shell script ignores it for what runs in the background, stop the arm first."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
