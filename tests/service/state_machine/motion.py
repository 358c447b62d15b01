"""Whether every motion of the arm was somebody's wish: from a scan's acceptance to its end, and never behind a stop."""

from dataclasses import dataclass, field

LATE_S = 0.1
"""The cell's state is told by another thread than the one that moves the arm, at most so much later."""


@dataclass
class Leases:
    """What was asked for, and in which state the cell was; all times are those of `time.monotonic()`."""

    states: list[tuple[float, str]] = field(default_factory=list)
    """Each state of the cell, and since when."""
    asked: list[float] = field(default_factory=list)
    """When a live scan was asked for that was accepted."""
    stopped: list[float] = field(default_factory=list)
    """When a stop was answered."""

    def check(self, began_s: float) -> None:
        """A motion that began at this moment had a lease."""
        asked = max((at for at in self.asked if at < began_s), default=None)
        assert asked is not None, "the arm moved, and nobody has asked for a scan"
        stopped = max((at for at in self.stopped if at < began_s), default=0.0)
        assert stopped < asked, f"the arm began to move {began_s - stopped:.3f} s after it was stopped"
        # The state at the moment, and those just before and behind it.
        before = [state for at, state in self.states if at <= began_s - LATE_S][-1:]
        near = [state for at, state in self.states if began_s - LATE_S < at <= began_s + LATE_S]
        assert "busy" in before + near, f"the arm began to move while the cell was {before + near}"
