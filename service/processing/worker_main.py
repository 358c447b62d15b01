"""The recognition process: its own loop, and what goes through the pipe to and from it."""

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path

import numpy as np

from cell.devices import View
from cell.process.logging import LoggingSetup
from cell.recording.header import RecordingHeader
from cell.recording.writer import read_recording
from recognition.grasping.gripper import Gripper
from recognition.model.model import Method, PointChainModel
from recognition.parameters import ChainParameters
from recognition.pipeline import Recognition
from service.errors import INPUT_ERRORS, Failure
from service.logs.setup import log_scan
from service.processing.preview import draw_preview
from service.processing.results import READING, WRITING, OnStage, recognise_views, write_preview, write_results
from service.storage.storage_errors import is_full

log = logging.getLogger(__name__)

YIELDING = 5
"""Nicer than the service by this: what watches the arm comes first where there are few cores."""


@dataclass(frozen=True)
class Task:
    """One scan to recognise."""

    source: Path | RecordingHeader
    """A recording, or the header of one that is being made: its views then follow through the pipe."""
    radius_m: float | None
    """None: it is measured, whatever the recording says."""
    method: Method
    gripper: Gripper
    results: Path
    """Folder to be made for the result's files."""
    preview: Path
    """File to be made for the result's picture, after the outcome is told."""
    missing: tuple[str, ...] = ()
    """What is known to be missing from a recording, in words, whether or not its file tells."""
    scan: str | None = None
    """Its id, for the log."""


@dataclass(frozen=True)
class LastView:
    """No more views come."""

    missing: tuple[str, ...]
    """Which are not there, and why."""


@dataclass(frozen=True)
class BrokenOff:
    """No more views come, and nobody wants to know what these would give."""


class BrokenOffError(Exception):
    """The task is not wanted any more."""


@dataclass(frozen=True)
class Ready:
    """The process waits for a task."""


@dataclass(frozen=True)
class Stage:
    """A stage begins."""

    name: str


@dataclass(frozen=True)
class PreviewEnded:
    """The picture is there, whole, or will never be."""


def work(pipe: Connection, set_up_log: LoggingSetup | None = None) -> None:
    """The process's own loop."""
    if set_up_log is not None:
        set_up_log(multiprocessing.current_process().name)
    for number in (signal.SIGINT, signal.SIGTERM):  # they may reach it too; the service ends it in its own time
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(YIELDING)
    try:
        _warm_up()
    except ImportError as error:
        # a compiled library may lack a library of the system
        pipe.send(Failure("recognition-crashed", f"a library cannot be loaded: {error}"))
        return
    pipe.send(Ready())
    while True:
        try:
            message = pipe.recv()
        except EOFError:
            return
        if not isinstance(message, Task):
            continue  # views of a task that has failed already
        try:
            with log_scan(message.scan):
                recognition = _do(message, pipe)
                if recognition is not None:
                    _draw(recognition, message.preview)
                    pipe.send(PreviewEnded())
        except BrokenPipeError:
            return


def _do(task: Task, pipe: Connection) -> Recognition | None:
    """Does a task and tells its outcome; None when it was refused."""
    try:
        recognition = _recognise(task, pipe, lambda name: pipe.send(Stage(name)))
        pipe.send(Stage(WRITING))
        pipe.send(write_results(recognition, task.results))
        return recognition
    except INPUT_ERRORS as error:
        refused = Failure(error.slug, str(error))
    except BrokenOffError:
        refused = Failure("aborted", "the scan was broken off")
    except (BrokenPipeError, EOFError):
        raise BrokenPipeError from None
    except Exception as error:
        if is_full(error):
            refused = Failure("storage-full", "no space is left in the data folder; free some and scan again")
        else:
            log.exception("recognition of %s failed", task.source)
            detail = f"recognition met an unexpected {type(error).__name__}: {error}: please report it"
            refused = Failure("recognition-crashed", detail)
    pipe.send(refused)
    return None


def _draw(recognition: Recognition, preview: Path) -> None:
    try:
        write_preview(recognition, preview)
    except Exception:  # the result is good without
        log.exception("the preview could not be drawn")
        preview.unlink(missing_ok=True)  # a full disk leaves a part of it


def _recognise(task: Task, pipe: Connection, on_stage: OnStage) -> Recognition:
    if isinstance(task.source, Path):
        on_stage(READING)
        recording = read_recording(task.source)
        known = tuple(dict.fromkeys((*task.missing, *recording.missing)))
        views, header = recording.views, recording.header
        return recognise_views(views, header, known, task.radius_m, task.method, on_stage, task.gripper)
    missing: list[str] = []

    def coming() -> Iterator[View]:
        while isinstance(message := pipe.recv(), View):
            yield message
        if isinstance(message, BrokenOff):
            raise BrokenOffError
        assert isinstance(message, LastView)
        missing.extend(message.missing)

    return recognise_views(coming(), task.source, missing, task.radius_m, task.method, on_stage, task.gripper)


def _warm_up() -> None:
    """The first picture takes longest, so that no scan waits for it. Recognition is imported by now."""
    draw_preview(PointChainModel("graph", ChainParameters.for_radius(0.004)), np.zeros((0, 3)))


def _end_with_parent() -> None:
    """A killed service leaves no process behind that writes into its data folder."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
