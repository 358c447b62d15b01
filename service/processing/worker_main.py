"""The recognition process: its main loop, and the messages on the pipe between it and the service."""

import logging
import multiprocessing
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cell.control.progress import MissingView
from cell.devices import View
from cell.process.logging import LoggingSetup
from cell.process.python_process import exit_with_parent
from cell.recording import read_recording
from cell.recording.header import RecordingHeader
from recognition.early_end.view_sufficiency import ViewChecks
from recognition.model.findings import Finding
from recognition.model.model import PointChainModel
from recognition.parameters import ChainParameters
from recognition.request import RecognitionRequest
from service.errors import INPUT_ERRORS, Failure
from service.logs.setup import scan_log_context
from service.processing.preview import draw_preview
from service.processing.results import (
    READING,
    WRITING,
    OnStage,
    Source,
    recognise_views,
    recording_findings,
    write_preview,
    write_results,
)
from service.storage.storage_errors import is_full

if TYPE_CHECKING:
    from recognition.result import Recognition

log = logging.getLogger(__name__)

NICE_INCREMENT = 5
"""Increment of the process's nice value, so that the service, which monitors the arm, has priority on few cores."""
WARM_UP_DELAY_S = 5.0
"""Time without a task after which the drawing is warmed up. At its start the service needs the cores itself."""


@dataclass(frozen=True)
class Task:
    """One scan to recognise."""

    source: Path | RecordingHeader
    """A recording, or the header of a recording in progress. With a header, the views follow through the pipe."""
    request: RecognitionRequest
    """How to recognise it. Without a radius, it is measured, also if the recording has one."""
    results: Path
    """Folder for the files of the result. The process creates it."""
    preview: Path
    """File for the preview. The process writes it after it has sent the outcome."""
    missing: tuple[Finding, ...] = ()
    """Notes on what is known to be missing from a recording, even if its file does not show it."""
    scan: str | None = None
    """Id of the scan, for the log and for the provenance of the model."""
    check_views: bool = False
    """Whether the views so far are recognised when a view arrives, to find out whether they suffice."""


@dataclass(frozen=True, eq=False)
class ViewBeforeNext:
    """Message to the process: a view after which the views are not recognised, because the next one follows at once."""

    view: View
    """The view."""


@dataclass(frozen=True)
class EndOfViews:
    """Message to the process: no more views follow."""

    missing: tuple[MissingView, ...]
    """The missing views, each with the reason."""


@dataclass(frozen=True)
class Cancelled:
    """Message to the process: no more views follow, and the result is not needed."""


class TaskCancelledError(Exception):
    """The service cancelled the task."""


@dataclass(frozen=True)
class Ready:
    """Message from the process: it waits for a task."""


@dataclass(frozen=True)
class Stage:
    """Message from the process: a stage begins."""

    name: str
    """Name of the stage."""


@dataclass(frozen=True)
class PreviewEnded:
    """Message from the process: the preview is complete, or drawing it failed and there is no file."""


def run_process(pipe: Connection, set_up_log: LoggingSetup | None = None) -> None:
    """Run the main loop of the recognition process.

    Args:
        pipe: Connection to the service.
        set_up_log: Sets up the log of the process, by the process's name. None: the log is left as it is.
    """
    if hasattr(os, "nice"):
        os.nice(NICE_INCREMENT)
    if set_up_log is not None:
        set_up_log(multiprocessing.current_process().name)
    for number in (signal.SIGINT, signal.SIGTERM):  # signals may reach the whole group; the service ends this process
        signal.signal(number, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        exit_with_parent(parent.sentinel)  # so that nothing writes into the service's data folder afterwards
    # not at the top of this module, which the service imports too
    import recognition.early_end.stepwise
    import recognition.pipeline

    pipe.send(Ready())
    if not pipe.poll(WARM_UP_DELAY_S):
        _warm_up_drawing()
    while True:
        try:
            message = pipe.recv()
        except EOFError:
            return
        if not isinstance(message, Task):
            continue  # views of a task that has failed already
        try:
            with scan_log_context(message.scan):
                recognition = _run_task(message, pipe)
                if recognition is not None:
                    _draw_preview(recognition, message.preview)
                    pipe.send(PreviewEnded())
        except BrokenPipeError:
            return


def _run_task(task: Task, pipe: Connection) -> "Recognition | None":
    """Run a task and send its outcome. Return None if it failed."""
    try:
        recognition = _recognise(task, pipe, lambda name: pipe.send(Stage(name)))
        pipe.send(Stage(WRITING))
        pipe.send(write_results(recognition, task.results))
        return recognition
    except INPUT_ERRORS as error:
        failure = Failure(error.slug, str(error))
    except TaskCancelledError:
        failure = Failure("aborted", "the scan was cancelled")
    except (BrokenPipeError, EOFError):
        raise BrokenPipeError from None
    except Exception as error:
        if is_full(error):
            failure = Failure("storage-full", "no space is left in the data folder; free some and scan again")
        else:
            log.exception("recognition of %s failed", task.source)
            message = f"recognition failed with an unexpected {type(error).__name__}: {error}; please report it"
            failure = Failure("recognition-crashed", message)
    pipe.send(failure)
    return None


def _draw_preview(recognition: "Recognition", preview: Path) -> None:
    try:
        write_preview(recognition, preview)
    except Exception:  # the result is valid without a preview
        log.exception("the preview could not be drawn")
        preview.unlink(missing_ok=True)  # a full disk leaves an incomplete file


def _recognise(task: Task, pipe: Connection, on_stage: OnStage) -> "Recognition":
    if isinstance(task.source, Path):
        on_stage(READING)
        recording = read_recording(task.source)
        return recognise_views(
            recording.views,
            recording.header,
            recording_findings(recording, task.missing),
            task.request,
            source=Source(task.scan),
            on_stage=on_stage,
        )
    missing: list[Finding] = []
    next_is_here = False

    def receive_views() -> Iterator[View]:
        nonlocal next_is_here
        while isinstance(message := pipe.recv(), View | ViewBeforeNext):
            next_is_here = isinstance(message, ViewBeforeNext)
            yield message.view if isinstance(message, ViewBeforeNext) else message
        if isinstance(message, Cancelled):
            raise TaskCancelledError
        assert isinstance(message, EndOfViews)
        missing.extend(view.finding for view in message.missing)

    source = Source(task.scan)
    if task.check_views:
        checks = ViewChecks(pipe.send, lambda: next_is_here)
        return recognise_views(receive_views(), task.source, missing, task.request, source=source, checks=checks)
    return recognise_views(receive_views(), task.source, missing, task.request, source=source, on_stage=on_stage)


def _warm_up_drawing() -> None:
    """Draw an empty preview, because the first one imports Matplotlib. A result is valid without a preview."""
    try:
        draw_preview(PointChainModel("graph", ChainParameters.for_radius(0.004)), np.zeros((0, 3)))
    except Exception:  # Matplotlib may need a system library that is missing
        log.exception("previews cannot be drawn: scans will have a result, but no preview")
