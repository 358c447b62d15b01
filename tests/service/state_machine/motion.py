"""A check that every motion of the arm belongs to an accepted scan and never follows a stop."""

from dataclasses import dataclass, field

LATE_S = 0.1
"""Maximum delay of a state report, in seconds. Another thread than the arm's reports the state of the cell."""


@dataclass
class MotionCheck:
    """The requests and the states of the cell. All times are those of `time.monotonic()`, in seconds."""

    states: list[tuple[float, str]] = field(default_factory=list)
    """The time of each change of the cell's state, and the new state."""
    requested: list[float] = field(default_factory=list)
    """Times of the requests for live scans that were accepted."""
    stopped: list[float] = field(default_factory=list)
    """Times of the answers to stops."""

    def check(self, began_s: float) -> None:
        """Assert that a motion that began at this time was requested."""
        requested = max((at for at in self.requested if at < began_s), default=None)
        assert requested is not None, "the arm moved, but no scan was requested"
        stopped = max((at for at in self.stopped if at < began_s), default=0.0)
        assert stopped < requested, f"the arm began to move {began_s - stopped:.3f} s after it was stopped"
        # The state at this time, and those just before and after it.
        before = [state for at, state in self.states if at <= began_s - LATE_S][-1:]
        near = [state for at, state in self.states if began_s - LATE_S < at <= began_s + LATE_S]
        assert "busy" in before + near, f"the arm began to move while the cell was {before + near}"
