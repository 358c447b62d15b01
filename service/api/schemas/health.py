"""Whether the service lives and is ready, as JSON."""

from typing import Literal

from cell.control.status import State
from service.api.schemas.base import Described


class Health(Described):
    """The service answers."""

    status: Literal["ok"] = "ok"


class ReadinessCheck(Described):
    """One thing that the service takes."""

    ok: bool
    words: str
    """How it is, for people."""


class ReadinessChecks(Described):
    """Each thing that the service takes."""

    store: ReadinessCheck
    recognition: ReadinessCheck
    disk: ReadinessCheck
    service: ReadinessCheck
    """It is not stopping, and its file of tokens can be read."""
    cell: State
    """Told only: a service whose cell is not ready is, since it connects the cell."""


class Readiness(Described):
    """The service can do a scan."""

    status: Literal["ready"] = "ready"
    checks: ReadinessChecks
