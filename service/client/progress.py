"""How a scan goes, as a program that waits for it sees it."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import httpx
from httpx_sse import ServerSentEvent, connect_sse

from service.client.errors import ProblemError, require_success
from service.client.retry import LOST, Patience
from service.states import ACTIVE_STATES, ScanState


@dataclass(frozen=True)
class ScanProgress:
    """Progress of a scan at one moment."""

    state: ScanState
    """State of the scan."""
    stage: str | None = None
    """Present or last stage."""
    fraction: float = 0.0
    """Completed share, 0 to 1."""
    views: Mapping[int, str] = field(default_factory=dict)
    """`moving`, `recorded` or `missing`, by the number of the viewpoint."""
    reasons: Mapping[int, str] = field(default_factory=dict)
    """Why views are missing, by the number of the viewpoint."""

    @property
    def ended(self) -> bool:
        """Whether the state is final."""
        return self.state not in ACTIVE_STATES

    def after(self, event: Mapping[str, Any]) -> "ScanProgress":
        """Return the progress after an event of the scan. An event of an unknown kind changes nothing."""
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


def follow(http: httpx.Client, address: str, patience: Patience) -> Iterator[ScanProgress]:
    """Each change of the scan at `address` until it has ended, over any number of lost connections.

    Where no more streams are let in, the scan is looked at now and then instead.

    Raises:
        ProblemError: there is no such scan, or it may not be read.
        UnreachableError: the service has not answered for a minute.
        NotEndedError: the deadline has come.
    """
    last: str | None = None
    progress: ScanProgress | None = None
    while True:
        lost: Exception | None = None
        try:
            for event in _events(http, address, last, patience):
                last = event.id or last
                present = _after(progress, event)
                if present is not None and present != progress:
                    yield present
                    if present.ended:
                        return
                    progress = present
                patience.refuse_late()
        except LOST as error:
            lost = error
        if isinstance(lost, ProblemError) and lost.slug == "too-many-streams":
            lost = None
            present = progress_of(look(http, address, patience))
            if present != progress:
                yield present
            if present.ended:
                return
            progress = present
        patience.pause(lost)


def look(http: httpx.Client, address: str, patience: Patience) -> dict[str, Any]:
    """What is at `address`, as soon as the service answers.

    Raises: ProblemError, UnreachableError and NotEndedError as `follow`.
    """
    while True:
        try:
            found = require_success(http.get(address, timeout=patience.timeout)).json()
        except LOST as error:
            patience.pause(error)
        else:
            patience.heard()
            return found


def _events(http: httpx.Client, address: str, last: str | None, patience: Patience) -> Iterator[ServerSentEvent]:
    headers = {} if last is None else {"Last-Event-ID": last}
    with connect_sse(http, "GET", f"{address}/events", headers=headers, timeout=patience.timeout) as source:
        require_success(source.response)
        for event in source.iter_sse():
            patience.heard()
            yield event


def _after(progress: ScanProgress | None, event: ServerSentEvent) -> ScanProgress | None:
    """What it is after an event of the stream; one without data is a sign of life, no more."""
    if not event.data:
        return progress
    content = json.loads(event.data)
    if event.event in ("scan", "resync"):
        return progress_of(content)
    return None if progress is None else progress.after(content)
