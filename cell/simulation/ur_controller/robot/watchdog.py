"""RTDE's watchdog, with which a program dies when its client falls silent."""

from dataclasses import dataclass


@dataclass
class Watchdog:
    """Fed by every RTDE package that writes the watched register, whatever it writes."""

    hz: float = 0.0
    """0 while it sleeps."""
    fed_s: float = 0.0
    """When it was last fed, `time.monotonic()`."""
    meals: int = 0
    """How often it was fed since it was armed."""
    excused_s: float = 0.0
    """Of the time since it was fed, how much does not count."""

    def arm(self, hz: float, now_s: float) -> None:
        """From now on it wants to be fed so often."""
        self.hz, self.fed_s, self.meals, self.excused_s = max(0.0, hz), now_s, 0, 0.0

    def feed(self, now_s: float) -> None:
        """The register was written."""
        self.fed_s, self.excused_s = now_s, 0.0
        self.meals += 1

    def excuse(self, since_s: float, now_s: float) -> None:
        """The controller itself did not run in that time: what came meanwhile it has yet to read, or has just read."""
        self.excused_s += max(0.0, now_s - max(since_s, self.fed_s))

    def silence_s(self, now_s: float) -> float:
        """How long it has not been fed, as far as that counts."""
        return now_s - self.fed_s - self.excused_s

    def hungry(self, now_s: float) -> bool:
        """It was not fed in time."""
        return self.hz > 0 and self.silence_s(now_s) > 1.0 / self.hz
