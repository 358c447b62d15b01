"""Run a task of a command that moves the arm. SIGINT and SIGTERM stop the arm."""

import sys
import threading
from collections.abc import Callable
from contextlib import closing
from typing import Any, TypeVar

from calibration.errors import HandEyeError
from cell.config.cell_config import CellSettings
from cell.control.cell import Cell
from cell.control.status import FAULTS
from cell.errors import CellError
from service.errors import INPUT_ERRORS
from service.problems.document import error_document
from service.processing.worker import TaskFailedError
from service.signals import INTERRUPTED_EXIT_CODE, run_with_signal_handler

Result = TypeVar("Result")


class EndedEarlyError(Exception):
    """The task ended without a result.

    Attributes:
        problem: The error as a document.
        code: Exit code of the command.
    """

    def __init__(self, problem: dict[str, Any], code: int) -> None:
        super().__init__(problem["detail"])
        self.problem = problem
        self.code = code


def run_with_cell(
    settings: CellSettings,
    task: Callable[[Cell, threading.Event], Result],
    output: object,
    on_signal: Callable[[], None] = lambda: None,
) -> Result:
    """Run a task with a cell, and close the cell afterwards. SIGINT and SIGTERM end the task.

    Args:
        settings: Settings of the cell.
        task: Receives the cell, and an event that is set when a signal requests a stop.
        output: File or folder that the task writes, for messages.
        on_signal: Called after the arm is stopped, also if that failed, to end the other work of the task.

    Returns:
        The result of the task.

    Raises:
        EndedEarlyError: A signal stopped the task, or the task raised an error that has a problem document.
    """
    cell, stop_requested = Cell(settings), threading.Event()

    def stop() -> None:
        stop_requested.set()
        try:
            cell.stop()
        finally:
            on_signal()
            cell.cancel_connecting()
        print("stopping", file=sys.stderr)

    def work() -> Result:
        with closing(cell):
            try:
                result = task(cell, stop_requested)
            except (TaskFailedError, CellError, HandEyeError, *INPUT_ERRORS, OSError) as error:
                # the error may follow from the stop; faults, wrong input and file errors do not, so they are reported
                if stop_requested.is_set() and not isinstance(error, (*FAULTS, *INPUT_ERRORS, OSError)):
                    raise _stopped() from error
                raise EndedEarlyError(_problem(error, output), 1) from error
        if stop_requested.is_set():  # the stop came after the last move
            raise _stopped()
        return result

    return run_with_signal_handler(work, stop)


def _stopped() -> EndedEarlyError:
    return EndedEarlyError(error_document("stopped", "stopped by request"), INTERRUPTED_EXIT_CODE)


def _problem(error: Exception, output: object) -> dict[str, Any]:
    if isinstance(error, TaskFailedError):
        return error_document(error.failure.slug, error.failure.message)
    if isinstance(error, (CellError, HandEyeError, *INPUT_ERRORS)):
        return error_document(error.slug, str(error))
    assert isinstance(error, OSError)
    where = error.filename or output
    return error_document("file", f"{where} cannot be written: {error.strerror or error}")
