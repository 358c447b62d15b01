"""Recognition in a process of its own: it keeps the event loop free, can be killed, and may crash.

The process is started before its first task, because its imports take more than a second. It is used again until it is
killed or dies.
"""

import logging
import multiprocessing
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

from cell.devices import View
from cell.process.logging import child_logging_setup
from service.errors import Failure
from service.processing.results import OnStage, Outcome
from service.processing.worker_main import BrokenOff, LastView, PreviewEnded, Stage, Task, work
from service.signals import ctrl_c_is_ours

log = logging.getLogger(__name__)

START_S = 60.0
"""A process that is not ready by then will not be."""
PREVIEW_S = 20.0
"""A picture that is not drawn by then will not be."""
BREAK_OFF_S = 2.0
"""A process that has not dropped its task by then is killed: the last views may be at work."""


class TaskFailedError(Exception):
    """A task gave no result; `failure` says why."""

    def __init__(self, slug: str, message: str) -> None:
        super().__init__(message)
        self.failure = Failure(slug, message)


class RecognitionWorker:
    """The process, seen from the service. `start`, `prepare` and `run` belong to one thread, `kill` to any."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._starting = threading.Lock()
        """Held while the process comes into being, so that `kill` finds all of it or nothing."""
        self._killed = False
        """A killed process may still look alive for a moment."""
        self._not_ready: str | None = "recognition is starting"
        self._waits = False
        """It has said that it is done with the last task, and nothing was sent since."""
        self.starts = 0
        """How many processes were started so far; each after the first means that the one before had ended."""

    @property
    def alive(self) -> bool:
        """The process runs, and will go on; it may be at work."""
        process = self._process
        return process is not None and not self._killed and process.exitcode is None

    @property
    def not_ready(self) -> str | None:
        """Why no task can be done now, or None; a process at work is ready."""
        if self._not_ready is None and not self.alive:
            return "recognition is starting again"
        return self._not_ready

    def prepare(self) -> None:
        """As `start`, but a failure is told by `not_ready`."""
        try:
            self.start()
        except TaskFailedError as error:
            # Killed while it started, or broken: the next task tries again and tells.
            self._not_ready = f"recognition did not start: {error}"

    def start(self) -> None:
        """Makes sure that a warmed-up process waits for a task; blocks until it does.

        Raises:
            TaskFailedError: it could not be started, ended before it was ready, or took too long.
        """
        if self.alive:
            return
        self._not_ready = "recognition is starting"
        self._release()
        context = multiprocessing.get_context("spawn")
        try:
            self._pipe, theirs = context.Pipe()
            process = context.Process(
                target=work, args=(theirs, child_logging_setup()), name="recognition", daemon=True
            )
            with theirs, self._starting, ctrl_c_is_ours():
                process.start()
                self._process, self._killed = process, False
            self.starts += 1
        except OSError as error:
            self._release()
            raise _not_started(error) from error
        message = self._receive(time.monotonic() + START_S)
        if isinstance(message, Failure):
            self.close()
            raise TaskFailedError(message.slug, message.message)
        self._not_ready = None

    def run(
        self,
        task: Task,
        on_stage: OnStage,
        limit_s: float,
        views: Iterable[View] = (),
        missing: Sequence[str] = (),
    ) -> Outcome:
        """Does one task in the started process; `on_stage` is called with the name of each stage as it begins.

        A scan under way gives its `views` as they are taken, and `missing` is read behind the last; the time limit
        begins there, and holds for the taking of each view. What iterating over `views` raises ends the task.

        Raises:
            TaskFailedError: the input was refused, the process died or was killed, or the time is over.
        """
        self._waits = False
        try:
            message = self._answer(task, on_stage, limit_s, views, missing)
        except BaseException:
            if not self._waits:
                self.kill()  # what it says later would be taken for the answer to the next task
            raise
        if isinstance(message, Failure):
            raise TaskFailedError(message.slug, message.message)
        return message

    def wait_for_preview(self) -> bool:
        """Waits for the picture of the task that has just given its outcome: whether the process came to its end.

        If not, it is dead, and what there is of the picture may be a part.
        """
        try:
            while not isinstance(self._receive(time.monotonic() + PREVIEW_S), PreviewEnded):
                pass
        except TaskFailedError:  # killed, or hanging: the next task starts a new process
            return False
        return True

    def kill(self) -> None:
        """Ends the process, if there is one, at once, whatever it does."""
        with self._starting:
            if self._process is not None:
                self._killed = True
                self._process.kill()

    def close(self) -> None:
        """Ends the process and waits for its end."""
        self.kill()
        self._release()

    def _answer(
        self, task: Task, on_stage: OnStage, limit_s: float, views: Iterable[View], missing: Sequence[str]
    ) -> Outcome | Failure:
        self._send(task, limit_s)
        if not isinstance(task.source, Path):
            for view in self._unless_broken_off(views):
                self._send(view, limit_s)
            self._send(LastView(tuple(missing)), limit_s)
        deadline = time.monotonic() + limit_s
        while True:
            message = self._receive(deadline)
            if isinstance(message, Stage):
                on_stage(message.name)
            elif isinstance(message, Failure | Outcome):
                return message

    def _unless_broken_off(self, views: Iterable[View]) -> Iterator[View]:
        """The views; when no more can be had, the process is told to drop its task, so that it need not be killed."""
        try:
            yield from views
        except Exception:
            self._break_off()
            raise

    def _break_off(self) -> None:
        try:
            self._send(BrokenOff(), BREAK_OFF_S)
            deadline = time.monotonic() + BREAK_OFF_S
            while not isinstance(self._receive(deadline), Failure):
                pass
            self._waits = True
        except TaskFailedError as error:  # it is dead; the next task starts another
            log.info("the recognition process did not drop its task: %s", error)

    def _send(self, message: object, limit_s: float) -> None:
        """A process that hangs takes nothing: without an end, sending would wait for ever once the pipe is full."""
        assert self._pipe is not None
        deadline, end = time.monotonic() + limit_s, threading.Timer(limit_s, self.kill)
        end.daemon = True
        try:
            end.start()  # Ctrl-C may come while it does
            self._pipe.send(message)
        except OSError as error:
            late, died = time.monotonic() >= deadline, self._died()
            raise (_late() if late else died) from error
        finally:
            end.cancel()

    def _receive(self, deadline: float) -> object:
        assert self._pipe is not None
        assert self._process is not None
        ready = wait([self._pipe, self._process.sentinel], timeout=max(0.0, deadline - time.monotonic()))
        if not ready:
            self.kill()
            self._release()
            raise _late()
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


def _not_started(error: OSError) -> TaskFailedError:
    return TaskFailedError(
        "recognition-crashed",
        f"no process for recognition could be started: {error.strerror or error}; it is tried again. If it stays so, "
        "end other programs, or allow the service more open files, processes or memory",
    )


def _late() -> TaskFailedError:
    return TaskFailedError("recognition-timeout", "recognition was stopped at its time limit")
