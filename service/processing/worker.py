"""The service's side of the recognition process.

Recognition runs in its own process: the event loop stays free, and the process may crash or be killed. It is started
before its first task, because its imports take more than a second, and nobody waits for it before the task needs it. It
is reused until it is killed or dies.
"""

import logging
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from pathlib import Path

from cell.control.progress import MissingView
from cell.devices import View
from cell.process.logging import child_logging_setup
from recognition.early_end.view_sufficiency import FIRST_CHECK, ViewCheck
from service.errors import Failure
from service.processing.results import OnStage, Outcome
from service.processing.worker_main import (
    Cancelled,
    EndOfViews,
    PreviewEnded,
    Stage,
    Task,
    ViewBeforeNext,
    run_process,
)
from service.signals import block_sigint_for_children

log = logging.getLogger(__name__)

CONTEXT: SpawnContext | ForkServerContext = multiprocessing.get_context("spawn")
"""Starts the process. A fork of this process would copy the locks that its threads hold."""
START_TIMEOUT_S = 60.0
"""Timeout for the process to become ready. It is killed after that."""
PREVIEW_TIMEOUT_S = 20.0
"""Timeout for drawing the preview."""
CANCEL_TIMEOUT_S = 2.0
"""Timeout for the process to drop a cancelled task. It is killed after that: it may still process the last views."""


OnCheck = Callable[[ViewCheck], None]
"""Called with what is doubtful after a view."""


class TaskFailedError(Exception):
    """A task gave no result.

    Attributes:
        failure: The reason.
    """

    def __init__(self, slug: str, message: str) -> None:
        super().__init__(message)
        self.failure = Failure(slug, message)


class RecognitionWorker:
    """Handle of the recognition process.

    `start`, `prepare`, `run` and `wait_for_preview` belong to one thread. `kill` may be called from any thread.
    """

    def __init__(self) -> None:
        """Create the handle; no process is started before `start` or `prepare`."""
        self._context = CONTEXT
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._starting = threading.Lock()
        """Held while the process is started, so that `kill` finds a complete process or none."""
        self._killed = False
        """True after `kill`: a killed process may still look alive for a moment."""
        self._not_ready_reason: str | None = "recognition is starting"
        self._ready_by: float | None = None
        """Time by which a process that is starting must be ready, monotonic seconds. None: it is ready, or was not
        started."""
        self._idle = False
        """True if the process has reported the end of the last task and nothing was sent since."""
        self.start_count = 0
        """Number of processes started so far. Each one after the first means that the one before had ended."""

    @property
    def alive(self) -> bool:
        """Whether the process runs and was not killed. It may be at work."""
        process = self._process
        return process is not None and not self._killed and process.exitcode is None

    @property
    def starting(self) -> bool:
        """Whether the process was started and is not known to be ready."""
        return self._ready_by is not None

    @property
    def not_ready_reason(self) -> str | None:
        """Why no task can be run now; None if one can. A process at work is ready."""
        if self._not_ready_reason is None and not self.alive:
            return "recognition is starting again"
        return self._not_ready_reason

    def prepare(self) -> None:
        """Start the process unless it is alive, and return at once. A failure is reported in `not_ready_reason`.

        Repeat the call until `not_ready_reason` is None: each call notices whether the process has become ready.
        """
        try:
            self._launch()
            if self._ready_by is not None and (self._has_message() or time.monotonic() > self._ready_by):
                self._await_ready(self._ready_by)
        except TaskFailedError as error:
            # killed during the start, or broken: the next task tries again and raises the error
            self._not_ready_reason = f"recognition did not start: {error}"

    def start(self) -> None:
        """Start the process unless it is alive, and wait until it has imported recognition and is ready for a task.

        Raises:
            TaskFailedError: The process could not be started, ended before it was ready, or took too long.
        """
        self._launch()
        if self._ready_by is not None:
            self._await_ready(self._ready_by)

    def run(
        self,
        task: Task,
        on_stage: OnStage,
        timeout_s: float,
        views: Iterable[View] = (),
        missing: Sequence[MissingView] = (),
        on_check: OnCheck = lambda _: None,
        next_is_here: Callable[[], bool] = lambda: False,
    ) -> Outcome:
        """Run one task in the started process and return its outcome.

        Args:
            task: The scan to recognise.
            on_stage: Called with the name of each stage as it begins.
            timeout_s: Timeout for sending each view, and for recognition after the last view.
            views: Views of a running scan, as they are taken. An error that the iteration raises ends the task.
            missing: Missing views. They are read after the last view.
            on_check: For a task with `check_views`, receives what is doubtful after each view, from the third on.
            next_is_here: For a task with `check_views`, whether `views` can yield the next view at once. The views
                before it are not checked then.

        Raises:
            TaskFailedError: The input was refused, the process died or was killed, or the time is over.
        """
        self._idle = False
        try:
            message = self._exchange(task, on_stage, timeout_s, views, missing, on_check, next_is_here)
        except BaseException:
            if not self._idle:
                self.kill()  # a late answer would be taken for the answer to the next task
            raise
        if isinstance(message, Failure):
            raise TaskFailedError(message.slug, message.message)
        return message

    def wait_for_preview(self) -> bool:
        """Wait for the preview of the task that has just ended.

        Returns:
            False if the process died. The file of the preview may then be incomplete.
        """
        try:
            while not isinstance(self._receive(time.monotonic() + PREVIEW_TIMEOUT_S), PreviewEnded):
                pass
        except TaskFailedError:  # killed, or hanging: the next task starts a new process
            return False
        return True

    def kill(self) -> None:
        """Kill the process at once, if there is one."""
        with self._starting:
            if self._process is not None:
                self._killed = True
                self._process.kill()

    def close(self) -> None:
        """Kill the process and wait for its end."""
        self.kill()
        self._release()

    def _launch(self) -> None:
        """Start the process unless it is alive."""
        if self.alive:
            return
        self._not_ready_reason = "recognition is starting"
        self._release()
        try:
            self._pipe, child_pipe = self._context.Pipe()
            process = self._context.Process(
                target=run_process, args=(child_pipe, child_logging_setup()), name="recognition", daemon=True
            )
            with child_pipe, self._starting, block_sigint_for_children():
                process.start()
                self._process, self._killed = process, False
            self.start_count += 1
        except OSError as error:
            self._release()
            raise _start_error(error) from error
        self._ready_by = time.monotonic() + START_TIMEOUT_S

    def _await_ready(self, deadline: float) -> None:
        self._receive(deadline)
        self._ready_by = None
        self._not_ready_reason = None

    def _has_message(self) -> bool:
        """Return whether the process has sent a message, or has ended."""
        assert self._pipe is not None
        assert self._process is not None
        return bool(wait([self._pipe, self._process.sentinel], timeout=0))

    def _exchange(
        self,
        task: Task,
        on_stage: OnStage,
        timeout_s: float,
        views: Iterable[View],
        missing: Sequence[MissingView],
        on_check: OnCheck,
        next_is_here: Callable[[], bool],
    ) -> Outcome | Failure:
        self._send(task, timeout_s)
        if not isinstance(task.source, Path):
            for number, view in enumerate(self._cancel_on_error(views), 1):
                is_skipped = task.check_views and number > FIRST_CHECK and next_is_here()
                self._send(ViewBeforeNext(view) if is_skipped else view, timeout_s)
                if task.check_views and number >= FIRST_CHECK and not is_skipped:
                    check = self._receive(time.monotonic() + timeout_s)
                    if isinstance(check, Failure):
                        return check
                    assert isinstance(check, ViewCheck)
                    on_check(check)
            self._send(EndOfViews(tuple(missing)), timeout_s)
        deadline = time.monotonic() + timeout_s
        while True:
            message = self._receive(deadline)
            if isinstance(message, Stage):
                on_stage(message.name)
            elif isinstance(message, Failure | Outcome):
                return message

    def _cancel_on_error(self, views: Iterable[View]) -> Iterator[View]:
        """Yield the views. If they raise an error, cancel the task, so that the process need not be killed."""
        try:
            yield from views
        except Exception:
            self._cancel_task()
            raise

    def _cancel_task(self) -> None:
        try:
            self._send(Cancelled(), CANCEL_TIMEOUT_S)
            deadline = time.monotonic() + CANCEL_TIMEOUT_S
            while not isinstance(self._receive(deadline), Failure):
                pass
            self._idle = True
        except TaskFailedError as error:  # it is dead; the next task starts another
            log.info("the recognition process did not drop its task: %s", error)

    def _send(self, message: object, timeout_s: float) -> None:
        """Send a message; kill the process at the timeout, because a full pipe would block forever if it hangs."""
        assert self._pipe is not None
        deadline, timer = time.monotonic() + timeout_s, threading.Timer(timeout_s, self.kill)
        timer.daemon = True
        try:
            timer.start()  # inside the try, because Ctrl-C may interrupt it
            self._pipe.send(message)
        except OSError as error:
            is_late, died = time.monotonic() >= deadline, self._died()
            raise (_timeout_error() if is_late else died) from error
        finally:
            timer.cancel()

    def _receive(self, deadline: float) -> object:
        assert self._pipe is not None
        assert self._process is not None
        ready = wait([self._pipe, self._process.sentinel], timeout=max(0.0, deadline - time.monotonic()))
        if not ready:
            self.kill()
            self._release()
            raise _timeout_error()
        try:
            # messages that the process sent before it died are still in the pipe
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
            f"the recognition process ended unexpectedly (exit code {code}); its log may have the reason",
        )

    def _release(self) -> int | None:
        """Wait for the end of the process and close the pipe. Return the exit code."""
        code = None
        self._ready_by = None
        if self._process is not None:
            self._process.join()
            code = self._process.exitcode
            with self._starting:
                self._process = None
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        return code


def _start_error(error: OSError) -> TaskFailedError:
    return TaskFailedError(
        "recognition-crashed",
        f"the recognition process could not be started: {error.strerror or error}; the service tries again. If this "
        "continues, end other programs, or allow the service more open files, processes or memory",
    )


def _timeout_error() -> TaskFailedError:
    return TaskFailedError("recognition-timeout", "recognition was stopped at its time limit")
