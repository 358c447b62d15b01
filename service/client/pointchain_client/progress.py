"""Progress of a scan, for a program that waits for its end."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import httpx2

from pointchain_client.errors import ProblemError, require_success
from pointchain_client.retry import RETRYABLE_ERRORS, RetryPolicy
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
    """Return the progress in a scan resource."""
    progress = scan["progress"]
    views = {view["index"]: view["state"] for view in progress["views"]}
    reasons = {view["index"]: view["reason"] for view in progress["views"] if view["reason"]}
    return ScanProgress(scan["state"], progress["stage"], progress["fraction"], views, reasons)


def follow(http: httpx2.Client, address: str, retry: RetryPolicy) -> Iterator[ScanProgress]:
    """Yield each change of a scan until it has ended, across any number of lost connections.

    If the service allows no more event streams, the scan is polled.

    Args:
        http: The HTTP client.
        address: Path of the scan.
        retry: The time limits and the pauses between attempts.

    Raises:
        ProblemError: There is no such scan, or the caller may not read it.
        UnreachableError: The service has not answered for a minute.
        NotEndedError: The deadline has passed.
    """
    last: str | None = None
    progress: ScanProgress | None = None
    while True:
        lost: Exception | None = None
        try:
            for event in _events(http, address, last, retry):
                last = event.id or last
                present = _progress_after(progress, event)
                if present is not None and present != progress:
                    yield present
                    if present.ended:
                        return
                    progress = present
                retry.raise_if_expired()
        except RETRYABLE_ERRORS as error:
            lost = error
        if isinstance(lost, ProblemError) and lost.slug == "too-many-streams":
            lost = None
            present = progress_of(get_json(http, address, retry))
            if present != progress:
                yield present
            if present.ended:
                return
            progress = present
        retry.wait_or_raise(lost)


def get_json(http: httpx2.Client, address: str, retry: RetryPolicy) -> dict[str, Any]:
    """Return the JSON document at `address`, as soon as the service answers.

    Raises:
        ProblemError: As for `follow`.
        UnreachableError: As for `follow`.
        NotEndedError: As for `follow`.
    """
    while True:
        try:
            found = require_success(http.get(address, timeout=retry.timeout)).json()
        except RETRYABLE_ERRORS as error:
            retry.wait_or_raise(error)
        else:
            retry.record_contact()
            return found


def _events(
    http: httpx2.Client, address: str, last: str | None, retry: RetryPolicy
) -> Iterator[httpx2.ServerSentEvent]:
    headers = {} if last is None else {"Last-Event-ID": last}
    with http.sse(f"{address}/events", headers=headers, timeout=retry.timeout) as source:
        require_success(source.response)
        for event in source:
            retry.record_contact()
            yield event


def _progress_after(progress: ScanProgress | None, event: httpx2.ServerSentEvent) -> ScanProgress | None:
    """Return the progress after an event of the stream. An event without data changes nothing."""
    if not event.data:
        return progress
    content = json.loads(event.data)
    if event.event in ("scan", "resync"):
        return progress_of(content)
    return None if progress is None else progress.after(content)
