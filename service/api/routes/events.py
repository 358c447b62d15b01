"""Routes of event streams: of one scan, or of all scans and the cell."""

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.responses import Response

from service.api.dependencies import Context, Scan, Service
from service.api.problem_responses import problem_responses
from service.api.server_sent_events import EventStream, EventSubscriber, SnapshotKind, all_stream, scan_stream
from service.events.cell_events import arm_event, cell_event
from service.problems.problem_error import ProblemError
from service.security.auth.caller import known_caller, still_allowed
from service.storage.event_log import MissedEvents, ScanEvent, ScanEvents, ScanSnapshot, UnknownEventError

router = APIRouter(prefix="/api", tags=["events"])

LastEventId = Annotated[
    int | None,
    Header(
        alias="Last-Event-ID",
        ge=0,
        lt=2**63,
        description="Id of the last event that the client has received; the stream continues after it",
    ),
]

Arm = Annotated[bool, Query(description="Whether the events include the joint angles of the arm")]


@dataclass(frozen=True)
class ScanStreamStart:
    """Start of a scan's event stream; the arguments of `scan_stream`."""

    scan: str
    subscriber: EventSubscriber
    begin: ScanSnapshot | MissedEvents
    snapshot_kind: SnapshotKind
    last_id: int


@dataclass(frozen=True)
class AllStreamStart:
    """Start of the event stream of all scans and the cell; the arguments of `all_stream`."""

    subscriber: EventSubscriber
    missed: list[ScanEvent]
    snapshot_kind: SnapshotKind
    last_id: int


async def _start_scan_stream(
    request: Request, scan: Scan, service: Service, last: LastEventId = None
) -> AsyncIterator[ScanStreamStart]:
    with _subscribe(request, service, scan.id) as subscriber:
        yield ScanStreamStart(
            scan.id, subscriber, *await to_thread.run_sync(_begin_scan, service.store.events, scan.id, last)
        )


async def _start_all_stream(
    request: Request, service: Service, last: LastEventId = None
) -> AsyncIterator[AllStreamStart]:
    with _subscribe(request, service, None) as subscriber:
        yield AllStreamStart(subscriber, *await to_thread.run_sync(_begin_all, service.store.events, last))


CHANGES = ("state", "progress", "view", "resync")
SCAN_DATA = "`scan` and `resync` have the scan as in `GET /api/scans/SCAN`"
ALL_DATA = """`cell` and `resync` have an object with the cell's `state`, `problem` and `reason`;
`arm` has an object with `q_rad` and `moving`, which are null while they are unknown"""


def _responses(names: tuple[str, ...], snapshot: str, *slugs: str) -> dict[int | str, dict[str, Any]]:
    description = f"""Server-sent events. Each event has a name and JSON data: {snapshot};
`state`, `progress` and `view` have an object with `id`, `scan`, `at`, `kind` and, in `data`, the change
(`state`: state, stage, fraction, problem, summary; `progress`: stage, fraction; `view`: index, state, reason).
Ids rise with each change."""
    # OpenAPI 3.2 calls this `itemSchema`; FastAPI, generators and validators are at 3.1
    content = {EventStream.media_type: {"x-itemSchema": _event_schema(names)}}
    return {200: {"description": description, "content": content}} | problem_responses(
        "event-unknown", "invalid-request", "not-ready", "too-many-streams", *slugs
    )


def _event_schema(names: tuple[str, ...]) -> dict[str, Any]:
    """Return the schema of one event, for the OpenAPI document."""
    properties = {
        "event": {"enum": names},
        "id": {"type": "string", "pattern": "^[0-9]+$"},
        "data": {"type": "string", "contentMediaType": "application/json"},
        "retry": {"type": "integer"},
    }
    return {"type": "object", "properties": properties, "required": ["event", "data"]}


@router.get(
    "/scans/{id}/events",
    status_code=200,
    response_class=EventStream,
    responses=_responses((*CHANGES, "scan"), SCAN_DATA, "scan-not-found")
    | {204: {"description": "The scan has ended, and the client has all its events"}},
)
async def stream_scan_events(
    request: Request, stream: Annotated[ScanStreamStart, Depends(_start_scan_stream)], service: Service
) -> Response:
    """Stream the changes of a scan as server-sent events. The stream ends with the final state.

    The first event is `scan` with the whole scan. Then `state`, `progress` and `view` have the changes. With
    `Last-Event-ID`, the stream has only the changes since that event. `resync` has the whole scan again, if the changes
    in between are not sent.
    """
    begin = stream.begin
    if isinstance(begin, MissedEvents) and begin.ended and not begin.events:
        return Response(status_code=204)  # a browser would reconnect again and again after any other status
    content = scan_stream(
        service.store.events, stream.scan, stream.subscriber, begin, stream.snapshot_kind, stream.last_id
    )
    return EventStream(content, still_allowed(request))


@router.get(
    "/events",
    status_code=200,
    response_class=EventStream,
    responses=_responses((*CHANGES, "cell", "arm"), ALL_DATA),
)
async def stream_events(
    request: Request,
    stream: Annotated[AllStreamStart, Depends(_start_all_stream)],
    service: Service,
    arm: Arm = False,
) -> Response:
    """Stream the changes of all scans and of the cell as server-sent events, without an end.

    The first event is `cell` with the state of the cell; it is sent again after each change of that state. `state`,
    `progress` and `view` are as in the events of one scan. With `Last-Event-ID`, the stream also has the changes of
    scans since that event. After `resync`, request the scans again: changes in between are not sent. With `arm=true`,
    the event `arm` has the joint angles of the arm whenever they change, up to ten times a second.
    """
    cell, events = service.cell, service.store.events
    content = all_stream(
        events,
        lambda: cell_event(cell.status),
        (lambda: arm_event(cell.status)) if arm else None,
        stream.subscriber,
        stream.missed,
        stream.snapshot_kind,
        stream.last_id,
    )
    return EventStream(content, still_allowed(request))


@contextmanager
def _subscribe(request: Request, service: Context, topic: str | None) -> Iterator[EventSubscriber]:
    """Take a stream slot and subscribe to a topic, or to all, until the client disconnects.

    Raises:
        ProblemError: `not-ready`: The service is stopping.
        ServiceError: `too-many-streams`: No slot is free.
    """
    hub = service.store.events.hub
    if hub.closed:
        raise ProblemError("not-ready", "the service is stopping")
    caller = known_caller(request.scope)
    with (
        service.streams.acquire(None if caller is None else caller.token_name),
        hub.subscribe(topic) as subscriber,
    ):
        yield subscriber


def _begin_scan(
    events: ScanEvents, scan_id: str, last: int | None
) -> tuple[ScanSnapshot | MissedEvents, SnapshotKind, int]:
    """Read the start of the stream. Call it after the subscription, which then has every later change."""
    snapshot_kind: SnapshotKind = "scan"
    if last is not None:
        with _event_problems():
            changes = events.since(scan_id, last)
        if changes is not None:
            return changes, snapshot_kind, last
        snapshot_kind = "resync"
    present = events.snapshot(scan_id)
    if present is None:  # removed after the dependency found it
        raise ProblemError(
            "scan-not-found", f"there is no scan {scan_id} any more; GET /api/scans lists them", scan=scan_id
        )
    return present, snapshot_kind, present.newest


def _begin_all(events: ScanEvents, last: int | None) -> tuple[list[ScanEvent], SnapshotKind, int]:
    snapshot_kind: SnapshotKind = "cell"
    if last is not None:
        with _event_problems():
            changes = events.all_since(last)
        if changes is not None:
            return changes, snapshot_kind, last
        snapshot_kind = "resync"
    return [], snapshot_kind, events.newest()


@contextmanager
def _event_problems() -> Iterator[None]:
    try:
        yield
    except UnknownEventError as error:
        detail = f"Last-Event-ID: {error}; leave it out to begin with the present state"
        raise ProblemError("event-unknown", detail) from error
