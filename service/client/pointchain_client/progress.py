"""Progress of a scan, reduced from its resource and its events."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import httpx2

from pointchain_client.answers import decoded
from pointchain_client.documents.scans import FINAL_STATES, Progress, ScanState
from pointchain_client.errors import AnswerError


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
    ended: bool = False
    """Whether the state is final."""

    def after(self, kind: str, data: Mapping[str, Any]) -> "ScanProgress":
        """Return the progress after an event of the scan. An event of an unknown kind changes nothing.

        Args:
            kind: Kind of the event.
            data: Values of the event.

        Raises:
            AnswerError: A value is missing or has another type.
        """
        match kind:
            case "state" | "progress":
                known = decoded(_Change, {**vars(self), "final": None, **data}, "an event of the scan")
                ended = self.ended if "state" not in data else _is_final(known.state, known.final)
                return replace(self, state=known.state, stage=known.stage, fraction=known.fraction, ended=ended)
            case "view":
                view = decoded(_View, data, "an event of the scan")
                views = {**self.views, view.index: view.state}
                reasons = {**self.reasons, view.index: view.reason} if view.reason else self.reasons
                return replace(self, views=views, reasons=reasons)
        return self


@dataclass(frozen=True)
class _Change:
    """Values of an event about the state or the progress, completed with those before it."""

    state: str
    stage: str | None
    fraction: float
    final: bool | None


@dataclass(frozen=True)
class _View:
    """Values of an event about a view."""

    index: int
    state: str
    reason: str | None


@dataclass(frozen=True)
class _Snapshot:
    """The members of a scan resource that its progress needs."""

    state: str
    progress: Progress
    final: bool | None = None


@dataclass(frozen=True)
class _Event:
    """Content of an event other than a scan resource."""

    kind: str = ""
    data: Mapping[str, Any] = field(default_factory=dict)


def progress_of(scan: Any) -> ScanProgress:
    """Return the progress in a scan resource.

    Args:
        scan: JSON document of the scan.

    Raises:
        AnswerError: A member is missing or has another type.
    """
    found = decoded(_Snapshot, scan, "the service")
    views = {view.index: view.state for view in found.progress.views}
    reasons = {view.index: view.reason for view in found.progress.views if view.reason}
    ended = _is_final(found.state, found.final)
    return ScanProgress(found.state, found.progress.stage, found.progress.fraction, views, reasons, ended)


def progress_after(progress: ScanProgress | None, event: httpx2.ServerSentEvent) -> ScanProgress | None:
    """Return the progress after an event of the stream. An event without data changes nothing.

    Args:
        progress: Progress before the event. None: not known yet.
        event: The event.

    Raises:
        AnswerError: The event is not one of the service.
    """
    if not event.data:
        return progress
    try:
        content = json.loads(event.data)
    except ValueError as error:
        raise AnswerError(f"an event of the scan is not JSON: {error}") from error
    if event.event in ("scan", "resync"):
        return progress_of(content)
    if progress is None:
        return None
    change = decoded(_Event, content, "an event of the scan")
    return progress.after(change.kind, change.data)


def _is_final(state: str, final: bool | None) -> bool:
    """Return whether a state is final. The service says so, because it may have states that are unknown here."""
    return state in FINAL_STATES if final is None else final
