"""Whether the service lives and is ready, as JSON."""

from typing import Literal

from pydantic import BaseModel

from cell.cell_status import State


class Health(BaseModel):
    """The service answers."""

    status: Literal["ok"] = "ok"


class ReadinessCheck(BaseModel):
    """One thing that the service takes."""

    ok: bool
    words: str
    """How it is, for people."""


class ReadinessChecks(BaseModel):
    """Each thing that the service takes."""

    store: ReadinessCheck
    recognition: ReadinessCheck
    disk: ReadinessCheck
    service: ReadinessCheck
    """It is not stopping."""
    cell: State
    """Told only: a service whose cell is not ready is, since it connects the cell."""


class Readiness(BaseModel):
    """The service can do a scan."""

    status: Literal["ready"] = "ready"
    checks: ReadinessChecks
