"""RTDE's watchdog, which ends a program when its client is silent."""

from dataclasses import dataclass


@dataclass
class Watchdog:
    """A watchdog that every RTDE package with the watched register keeps alive, whatever its value."""

    hz: float = 0.0
    """Frequency, or 0 while the watchdog is off."""
    kicked_s: float = 0.0
    """Time of the last signal, `time.monotonic()`."""
    kicks: int = 0
    """Number of signals since the start."""
    excused_s: float = 0.0
    """Part of the time since the last signal that does not count."""

    def arm(self, hz: float, now_s: float) -> None:
        """Start the watchdog with a frequency."""
        self.hz, self.kicked_s, self.kicks, self.excused_s = max(0.0, hz), now_s, 0, 0.0

    def kick(self, now_s: float) -> None:
        """Record that the register was written."""
        self.kicked_s, self.excused_s = now_s, 0.0
        self.kicks += 1

    def excuse(self, since_s: float, now_s: float) -> None:
        """Excuse a time in which the controller itself did not run and could not read packages."""
        self.excused_s += max(0.0, now_s - max(since_s, self.kicked_s))

    def silence_s(self, now_s: float) -> float:
        """Return the time without a signal that counts."""
        return now_s - self.kicked_s - self.excused_s

    def expired(self, now_s: float) -> bool:
        """Return whether the signal is overdue."""
        return self.hz > 0 and self.silence_s(now_s) > 1.0 / self.hz
