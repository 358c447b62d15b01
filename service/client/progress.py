"""How a scan goes, as a program that waits for it sees it."""

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import httpx
from httpx_sse import ServerSentEvent, SSEError, connect_sse

from service.client.errors import ProblemError, UnreachableError, require_success
from service.schemas import ACTIVE_STATES, ScanState

QUIET_S = 45.0
"""The service sends something at least every 15 s; a connection that is silent for so long is dead."""
AGAIN_S = 0.5
"""Before the events are asked for again, or the scan is looked at."""
LOST_S = 60.0
"""For so long a service that does not answer is asked again: it may be starting anew."""
FOR_NOW = frozenset({"not-ready", "busy"})
"""Refusals of a service that is just ending or starting, or whose database another program holds."""


@dataclass(frozen=True)
class ScanProgress:
    """A scan at one moment."""

    state: ScanState
    stage: str | None = None
    """What is being done, or was done last."""
    fraction: float = 0.0
    """Done of the whole, 0 to 1."""
    views: Mapping[int, str] = field(default_factory=dict)
    """`moving`, `recorded` or `missing`, by the viewpoints' numbers."""
    reasons: Mapping[int, str] = field(default_factory=dict)
    """Why views are missing."""

    @property
    def ended(self) -> bool:
        """The state is final."""
        return self.state not in ACTIVE_STATES

    def after(self, event: Mapping[str, Any]) -> "ScanProgress":
        """What it is after an event of the scan; one of a kind that is not known changes nothing."""
        data = event.get("data", {})
        match event.get("kind"):
            case "state" | "progress":
                known = {name: data[name] for name in ("state", "stage", "fraction") if name in data}
                return replace(self, **known)
            case "view":
                views = {**self.views, data["index"]: data["state"]}
                reasons = {**self.reasons, data["index"]: data["reason"]} if data["reason"] else self.reasons
                return replace(self, views=views, reasons=reasons)
        return self


def progress_of(scan: Mapping[str, Any]) -> ScanProgress:
    """That of a scan's resource."""
    progress = scan["progress"]
    views = {view["index"]: view["state"] for view in progress["views"]}
    reasons = {view["index"]: view["reason"] for view in progress["views"] if view["reason"]}
    return ScanProgress(scan["state"], progress["stage"], progress["fraction"], views, reasons)


def follow(http: httpx.Client, address: str, deadline: float | None) -> Iterator[ScanProgress]:
    """Each change of the scan at `address` until it has ended, over any number of lost connections.

    Where no more streams are let in, the scan is looked at now and then instead. `deadline` of `time.monotonic()`.

    Raises:
        ProblemError: there is no such scan, or it may not be read.
        UnreachableError: the service has not answered for a minute.
        TimeoutError: the deadline has come.
    """
    last: str | None = None
    progress: ScanProgress | None = None
    heard = time.monotonic()
    while progress is None or not progress.ended:
        try:
            try:
                for event in _events(http, address, last, deadline):
                    heard, last = time.monotonic(), event.id or last
                    content = json.loads(event.data) if event.data else {}
                    if event.event in ("scan", "resync"):
                        progress = progress_of(content)
                    elif progress is not None:
                        progress = progress.after(content)
                    else:
                        continue
                    yield progress
                    _refuse_late(deadline, address)
            except ProblemError as error:
                if error.slug != "too-many-streams":
                    raise
                progress, heard = _look(http, address), time.monotonic()
                yield progress
        except (httpx.TransportError, SSEError, ProblemError) as error:
            if isinstance(error, ProblemError) and error.slug not in FOR_NOW:
                raise
            if time.monotonic() - heard > LOST_S:
                raise UnreachableError(f"{http.base_url} has not answered for {LOST_S:.0f} s: {error}") from error
        if progress is None or not progress.ended:
            _refuse_late(deadline, address)
            time.sleep(AGAIN_S)


def _events(http: httpx.Client, address: str, last: str | None, deadline: float | None) -> Iterator[ServerSentEvent]:
    headers = {} if last is None else {"Last-Event-ID": last}
    left_s = QUIET_S if deadline is None else min(QUIET_S, max(0.05, deadline - time.monotonic()))
    wait = httpx.Timeout(left_s, connect=http.timeout.connect)
    with connect_sse(http, "GET", f"{address}/events", headers=headers, timeout=wait) as source:
        require_success(source.response)
        yield from source.iter_sse()


def _look(http: httpx.Client, address: str) -> ScanProgress:
    return progress_of(require_success(http.get(address)).json())


def _refuse_late(deadline: float | None, address: str) -> None:
    if deadline is not None and time.monotonic() > deadline:
        raise TimeoutError(f"{address} has not ended in time; it goes on: cancel or stop it")
