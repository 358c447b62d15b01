"""What a person is told while the arm moves for a calibration."""

import sys
import threading

from cell.control.calibration_run import BoardObservation
from cell.errors import StoppedError
from cell.planning.viewpoints import ViewpointPlan


class ToldCalibration:
    """Tells how it goes, and lets no move begin once a stop was asked for."""

    def __init__(self, plan: ViewpointPlan, stop_asked: threading.Event, command: str) -> None:
        self._stop_asked, self._command = stop_asked, command
        self._views, self._taken = plan.reached, 0

    def moving(self, index: int) -> None:
        """The arm is about to move. Raises StoppedError."""
        if self._stop_asked.is_set():  # before the cell was at work, so that it knows of none
            raise StoppedError("stopped by request")
        self.say(f"moving to pose {index}")

    def recorded(self, index: int) -> None:
        """The picture is on the disk."""
        self._taken += 1
        self.say(f"pose {index}: picture {self._taken} of {self._views}")

    def missing(self, index: int, reason: str) -> None:
        """There is no such picture."""
        self.say(f"pose {index} is missing: {reason}")

    def detected(self, index: int, board: BoardObservation, coverage: float) -> None:
        """The board was found in it."""
        fit = "" if board.rms_px is None else f", {board.rms_px:.2f} px off"
        found = f"{board.corners} of {board.possible} corners{fit}"
        self.say(f"pose {index}: {found}; {coverage:.0%} of the image covered so far")

    def not_detected(self, index: int, reason: str) -> None:
        """The board was not found in it."""
        self.say(f"pose {index} is left out: {reason}")

    def home(self) -> None:
        """The arm is home."""
        self.say("the arm is home, working it out")

    def say(self, words: str) -> None:
        """To the person."""
        print(f"pointchain calibrate {self._command}: {words}", file=sys.stderr)
