"""JSON documents of liveness and readiness."""

from typing import Literal

from cell.control.status import State
from service.api.schemas.base import ApiModel


class Health(ApiModel):
    """The service is alive."""

    status: Literal["ok"] = "ok"


class ReadinessCheck(ApiModel):
    """Result of one readiness check."""

    ok: bool
    message: str
    """Message for people."""


class ReadinessChecks(ApiModel):
    """Results of all readiness checks."""

    store: ReadinessCheck
    recognition: ReadinessCheck
    disk: ReadinessCheck
    service: ReadinessCheck
    """The service is not stopping, and its file of tokens can be read."""
    cell: State
    """Reported only. It does not count, because a service whose cell is not ready can connect the cell."""


class Readiness(ApiModel):
    """The service can run a scan."""

    status: Literal["ready"] = "ready"
    checks: ReadinessChecks
