"""One task of a command line that moves the arm of the configured cell: a signal stops it."""

import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import Any, TypeVar

from calibration.errors import HandEyeError
from cell.cell import Cell
from cell.cell_status import FAULTS
from cell.errors import CellError
from cell.settings import CellSettings
from service.at_a_signal import STOPPED_CODE, at_a_signal
from service.problems import cell_problem, problem_document

Result = TypeVar("Result")


class EndedEarlyError(Exception):
    """The task came to no result; with the problem document, and the command's exit code."""

    def __init__(self, problem: dict[str, Any], code: int) -> None:
        super().__init__(problem["detail"])
        self.problem = problem
        self.code = code


def with_moving_cell(settings: CellSettings, do: Callable[[Cell, threading.Event], Result]) -> Result:
    """What `do` gives, called with the cell and an event that is set once a stop was asked for. It is closed then.

    SIGINT and SIGTERM stop the arm first and then let `do` end.

    Raises:
        EndedEarlyError: stopped, or a CellError, HandEyeError or OSError of `do`.
    """
    cell, stop_asked = Cell(settings), threading.Event()

    def stop() -> None:
        stop_asked.set()
        try:
            cell.stop()
        finally:
            cell.give_up_connecting()
        print("stopping", file=sys.stderr)

    def work() -> Result:
        with closing(cell):
            try:
                result = do(cell, stop_asked)
            except (CellError, HandEyeError, OSError) as error:
                # What else went wrong at the same time is told instead.
                if stop_asked.is_set() and not isinstance(error, (*FAULTS, OSError)):
                    raise _stopped() from error
                raise EndedEarlyError(_problem(error), 1) from error
        if stop_asked.is_set():  # when the arm had nothing more to do
            raise _stopped()
        return result

    # In a thread of its own: a signal comes between any two lines of the main one, and that one only waits.
    with ThreadPoolExecutor(1) as pool, at_a_signal(stop):
        return pool.submit(work).result()


def _stopped() -> EndedEarlyError:
    return EndedEarlyError(problem_document(409, "stopped", "stopped by request"), STOPPED_CODE)


def _problem(error: CellError | HandEyeError | OSError) -> dict[str, Any]:
    match error:
        case CellError():
            return cell_problem(error)
        case HandEyeError():
            return problem_document(422, error.slug, str(error))
    return problem_document(507, "file", f"{error.filename or 'a file'} cannot be written: {error.strerror or error}")
