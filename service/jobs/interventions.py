"""Who stopped the arm last, and who acknowledged the last fault."""

from dataclasses import dataclass

from service.storage.database import now


@dataclass(frozen=True)
class Intervention:
    """A stop of the arm, or the acknowledgement of a fault."""

    at: str
    """Time, RFC 3339."""
    by: str | None
    """Name of the caller. None for one without a token, and for the service itself."""


class Interventions:
    """The last interventions since the service started. Any thread may record one."""

    def __init__(self) -> None:
        self.stop: Intervention | None = None
        """The last stop of the arm, or of a job that uses it."""
        self.acknowledgement: Intervention | None = None
        """The last acknowledgement of a fault."""

    def record_stop(self, by: str | None) -> None:
        """Record a stop, before the arm is stopped."""
        self.stop = Intervention(now(), by)

    def record_acknowledgement(self, by: str | None) -> None:
        """Record that a fault was acknowledged."""
        self.acknowledgement = Intervention(now(), by)
