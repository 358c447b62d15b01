"""Progress messages while the arm moves for a calibration or a verification."""

import sys
import threading

from cell.control.calibration_run import BoardObservation
from cell.errors import StoppedError
from cell.planning.viewpoints import ViewpointPlan


class CalibrationProgress:
    """Prints the progress to stderr, and prevents the next move after a stop request."""

    def __init__(self, plan: ViewpointPlan, stop_requested: threading.Event, command: str) -> None:
        self._stop_requested, self._command = stop_requested, command
        self._views, self._taken = plan.reachable, 0

    def moving(self, index: int) -> None:
        """Report the next move.

        Raises:
            StoppedError: A stop was requested.
        """
        if self._stop_requested.is_set():  # a stop before the cell received the request does not cancel it
            raise StoppedError("stopped by request")
        self.report(f"moving to pose {index}")

    def recorded(self, index: int) -> None:
        """Report that the image is on the disk."""
        self._taken += 1
        self.report(f"pose {index}: image {self._taken} of {self._views}")

    def missing(self, index: int, reason: str) -> None:
        """Report that the pose has no image."""
        self.report(f"pose {index} is missing: {reason}")

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """Report that the board was detected in the image."""
        fit = "" if board.rms_px is None else f", {board.rms_px:.2f} px off"
        found = f"{board.corners} of {board.board_corners} corners{fit}"
        self.report(f"pose {index}: {found}; {coverage:.0%} of the image covered so far")

    def not_detected(self, index: int, reason: str) -> None:
        """Report that the board was not detected in the image."""
        self.report(f"pose {index} is excluded: {reason}")

    def home(self) -> None:
        """Report that the arm is home."""
        self.report("the arm is home; solving")

    def report(self, message: str) -> None:
        """Print a message to stderr."""
        print(f"pointchain calibrate {self._command}: {message}", file=sys.stderr)
