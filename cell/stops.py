"""Which stop counts for what: one that came since something was prepared keeps it from moving."""

from cell.cell_status import KeptStatus
from cell.errors import StoppedError

STOPPED = "stopped by request: connect, or start a live scan"


class Stops:
    """The stops that somebody asked for. Safe to use from any thread; nothing here waits."""

    def __init__(self, status: KeptStatus) -> None:
        self._status = status
        self.last = object()
        """Another one with every stop: what is prepared keeps the one of its beginning."""

    def note(self) -> None:
        """Somebody asks for a stop; the arm is stopped, and `told` called, behind this."""
        self.last = object()

    def told(self) -> None:
        """A cell that was ready is not any more."""
        self._status.no_longer_ready("stopped", STOPPED)

    def since(self, before: object) -> bool:
        """One came behind the one that was `last` before."""
        return self.last is not before

    def refuse_since(self, before: object) -> None:
        """Raises StoppedError when one came."""
        if self.since(before):
            self.told()
            raise StoppedError("the arm was stopped by request before it began to move")
