"""Recognition in a process of its own: it keeps the event loop free, can be killed, and may crash.

The process is started ahead of its first task, because importing Open3D takes seconds, and is used again and
again until it is killed or dies.
"""

import errno
import logging
import multiprocessing
import os
import signal
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from recognition.gripper import Gripper
from recognition.model import Method, PointChainModel
from recognition.parameters import ChainParameters
from service.preview import draw_preview
from service.problems import INPUT_ERRORS, problem_document
from service.workflow import WRITING, OnStage, Outcome, recognise_recording, write_results

log = logging.getLogger(__name__)

START_S = 60.0
"""A process that is not ready by then will not be."""


@dataclass(frozen=True)
class Task:
    """One recording to recognise."""

    recording: Path
    radius_m: float | None
    method: Method
    gripper: Gripper
    results: Path
    """Folder to be made for the result's files."""


@dataclass(frozen=True)
class _Ready:
    pass


@dataclass(frozen=True)
class _Stage:
    name: str


@dataclass(frozen=True)
class _Refused:
    status: int
    slug: str
    detail: str


class TaskFailedError(Exception):
    """A task that gave no result; `problem` says why."""

    def __init__(self, status: int, slug: str, detail: str) -> None:
        super().__init__(detail)
        self.problem = problem_document(status, slug, detail)


class RecognitionWorker:
    """The process, seen from the service. `start` and `run` belong to one thread, `kill` to any."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._starting = threading.Lock()
        """Held while the process comes into being, so that `kill` finds all of it or nothing."""

    @property
    def alive(self) -> bool:
        """The process runs; it may be at work."""
        process = self._process
        return process is not None and process.exitcode is None

    def start(self) -> None:
        """Makes sure that a warmed-up process waits for a task; blocks until it does.

        Raises:
            TaskFailedError: it ended before it was ready, or took too long.
        """
        if self.alive:
            return
        self._release()
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs,), name="recognition", daemon=True)
        with self._starting:
            process.start()
            self._process = process
        theirs.close()
        message = self._receive(time.monotonic() + START_S)
        if isinstance(message, _Refused):
            self.close()
            raise TaskFailedError(message.status, message.slug, message.detail)

    def run(self, task: Task, on_stage: OnStage, limit_s: float) -> Outcome:
        """Does one task in the started process; `on_stage` is called with the name of each stage as it
        begins.

        Raises:
            TaskFailedError: the input was refused, the process died or was killed, or the time is over.
        """
        assert self._pipe is not None
        deadline = time.monotonic() + limit_s
        try:
            self._pipe.send(task)
        except OSError as error:
            raise self._died() from error
        while True:
            message = self._receive(deadline)
            if isinstance(message, _Stage):
                on_stage(message.name)
            elif isinstance(message, _Refused):
                raise TaskFailedError(message.status, message.slug, message.detail)
            elif isinstance(message, Outcome):
                return message

    def kill(self) -> None:
        """Ends the process, if there is one, at once, whatever it does."""
        with self._starting:
            if self._process is not None:
                self._process.kill()

    def close(self) -> None:
        """Ends the process and waits for its end."""
        self.kill()
        self._release()

    def _receive(self, deadline: float) -> object:
        assert self._pipe is not None
        assert self._process is not None
        ready = wait([self._pipe, self._process.sentinel], timeout=max(0.0, deadline - time.monotonic()))
        if not ready:
            self.kill()
            self._release()
            raise TaskFailedError(500, "recognition-timeout", "recognition was stopped at its time limit")
        try:
            # What the process said before it died is still in the pipe.
            if self._pipe.poll():
                return self._pipe.recv()
        except (EOFError, OSError) as error:
            raise self._died() from error
        raise self._died()

    def _died(self) -> TaskFailedError:
        self.kill()
        code = self._release()
        return TaskFailedError(
            500,
            "recognition-crashed",
            f"the recognition process ended unexpectedly (exit code {code}); its log may say more",
        )

    def _release(self) -> int | None:
        code = None
        if self._process is not None:
            self._process.join()
            code = self._process.exitcode
            with self._starting:
                self._process = None
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        return code


def _work(pipe: Connection) -> None:
    """The process's own loop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches it too; the service ends it in its own time
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        _warm_up()
    except ImportError as error:
        # Open3D without one of the system's libraries.
        pipe.send(_Refused(500, "recognition-crashed", f"a library cannot be loaded: {error}"))
        return
    pipe.send(_Ready())
    while True:
        try:
            task: Task = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send(_do(task, pipe))
        except BrokenPipeError:
            return


def _do(task: Task, pipe: Connection) -> Outcome | _Refused:
    try:
        recognition = recognise_recording(
            task.recording, task.radius_m, task.method, lambda name: pipe.send(_Stage(name)), task.gripper
        )
        pipe.send(_Stage(WRITING))
        return write_results(recognition, task.results)
    except INPUT_ERRORS as error:
        return _Refused(422, error.slug, str(error))
    except BrokenPipeError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return _Refused(507, "storage-full", "no space is left in the data folder; free some and scan again")
        log.exception("recognition of %s failed", task.recording)
        detail = f"recognition met an unexpected {type(error).__name__}: {error}: please report it"
        return _Refused(500, "recognition-crashed", detail)


def _warm_up() -> None:
    """The first picture takes longest, so that no scan waits for it. Recognition is imported by now."""
    draw_preview(PointChainModel("graph", ChainParameters.for_radius(0.004)), np.zeros((0, 3)))


def _end_with_parent() -> None:
    """A killed service leaves no process behind that writes into its data folder."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
