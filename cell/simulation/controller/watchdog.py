"""RTDE's watchdog, with which a program dies when its client falls silent."""

from dataclasses import dataclass


@dataclass
class Watchdog:
    """Fed by every RTDE package that writes the watched register, whatever it writes."""

    hz: float = 0.0
    """0 while it sleeps."""
    fed_s: float = 0.0
    """When it was last fed, `time.monotonic()`; later by what was excused."""
    meals: int = 0
    """How often it was fed since it was armed."""

    def arm(self, hz: float, now_s: float) -> None:
        """From now on it wants to be fed so often."""
        self.hz, self.fed_s, self.meals = max(0.0, hz), now_s, 0

    def feed(self, now_s: float) -> None:
        """The register was written."""
        self.fed_s = now_s
        self.meals += 1

    def excuse(self, missed_s: float) -> None:
        """The controller itself did not run for so long: what came meanwhile it has yet to read."""
        self.fed_s += missed_s

    def hungry(self, now_s: float) -> bool:
        """It was not fed in time."""
        return self.hz > 0 and now_s - self.fed_s > 1.0 / self.hz
