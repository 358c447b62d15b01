"""Progress messages of the commands that move the arm."""

import threading
from collections.abc import Callable

from cell.control.prepared import Prepared, PreparedScan
from cell.control.progress import BoardObservation, ViewTiming
from cell.errors import StoppedError

Report = Callable[[str], None]
"""Prints a message to stderr, with the name of the command."""


class TerminalProgress:
    """Reports the progress of a scan, a calibration or a verification. It is a `ProgressListener`.

    After a stop request it prevents the next move.
    """

    def __init__(self, prepared: Prepared, report: Report, stop_requested: threading.Event) -> None:
        """Create the listener; nothing is reported yet.

        Args:
            prepared: What the cell will run.
            report: Receives each message.
            stop_requested: Event that prevents the next move.
        """
        self._report, self._stop_requested = report, stop_requested
        self._position, self._view = ("viewpoint", "view") if prepared.purpose == "scan" else ("pose", "pose")
        self._views, self._taken = str(prepared.plan.reachable), 0
        if isinstance(prepared, PreparedScan) and prepared.may_end_after is not None:
            self._views = f"{prepared.may_end_after} to {self._views}"

    def moving(self, index: int) -> None:
        """Report the next move.

        Raises:
            StoppedError: A stop was requested.
        """
        if self._stop_requested.is_set():  # a stop before the cell received the request does not cancel it
            raise StoppedError("stopped by request")
        self._report(f"moving to {self._position} {index}")

    def recorded(self, index: int, timing: ViewTiming) -> None:
        """Report that the view is on the disk."""
        self._taken += 1
        self._report(f"{self._view} {index} recorded, {self._taken} of {self._views}")

    def missing(self, index: int, reason: str) -> None:
        """Report that there is no such view, and why."""
        self._report(f"{self._view} {index} is missing: {reason}")

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """Report that the board was detected in the image."""
        fit = "" if board.rms_px is None else f", {board.rms_px:.2f} px off"
        found = f"{board.corners} of {board.board_corners} corners{fit}"
        self._report(f"pose {index}: {found}; {coverage:.0%} of the image covered so far")

    def not_detected(self, index: int, reason: str) -> None:
        """Report that the board was not detected in the image."""
        self._report(f"pose {index} is excluded: {reason}")

    def home(self) -> None:
        """Report that the arm is home."""
        self._report("the arm is home; solving")
