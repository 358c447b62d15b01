"""One task of a command line that moves the arm of the configured cell: a signal stops it."""

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
from service.signals import STOPPED_CODE, with_signals

Result = TypeVar("Result")


class EndedEarlyError(Exception):
    """The task came to no result; with the error as a document, and the command's exit code."""

    def __init__(self, problem: dict[str, Any], code: int) -> None:
        super().__init__(problem["detail"])
        self.problem = problem
        self.code = code


def with_moving_cell(
    settings: CellSettings,
    do: Callable[[Cell, threading.Event], Result],
    written: object,
    at_signal: Callable[[], None] = lambda: None,
) -> Result:
    """What `do` gives, called with the cell and an event that is set once a stop was asked for. It is closed then.

    SIGINT and SIGTERM stop the arm first, then do what `at_signal` does, and `do` ends by either. `written`: the file
    or folder that `do` writes, for messages.

    Raises:
        EndedEarlyError: stopped, or an error of `do` that has a problem document.
    """
    cell, stop_asked = Cell(settings), threading.Event()

    def stop() -> None:
        stop_asked.set()
        try:
            cell.stop()
        finally:
            at_signal()
            cell.cancel_connecting()
        print("stopping", file=sys.stderr)

    def work() -> Result:
        with closing(cell):
            try:
                result = do(cell, stop_asked)
            except (TaskFailedError, CellError, HandEyeError, *INPUT_ERRORS, OSError) as error:
                # What else went wrong at the same time is told instead.
                if stop_asked.is_set() and not isinstance(error, (*FAULTS, *INPUT_ERRORS, OSError)):
                    raise _stopped() from error
                raise EndedEarlyError(_problem(error, written), 1) from error
        if stop_asked.is_set():  # when the arm had nothing more to do
            raise _stopped()
        return result

    return with_signals(work, stop)


def _stopped() -> EndedEarlyError:
    return EndedEarlyError(error_document("stopped", "stopped by request"), STOPPED_CODE)


def _problem(error: Exception, written: object) -> dict[str, Any]:
    if isinstance(error, TaskFailedError):
        return error_document(error.failure.slug, error.failure.message)
    if isinstance(error, (CellError, HandEyeError, *INPUT_ERRORS)):
        return error_document(error.slug, str(error))
    assert isinstance(error, OSError)
    where = error.filename or written
    return error_document("file", f"{where} cannot be written: {error.strerror or error}")
