"""Changes as they happen: of one scan, or of everything."""

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Depends, Header, Request
from fastapi.responses import Response

from service.api.dependencies import Context, Scan, Service
from service.api.problem_responses import problem_responses
from service.api.server_sent_events import EventStream, News, Whole, all_stream, scan_stream
from service.events.cell_events import cell_event
from service.problems.problem_error import ProblemError
from service.security.auth.caller import known_caller, still_allowed
from service.storage.event_log import Behind, Present, ScanEvent, ScanEvents, UnknownEventError

router = APIRouter(prefix="/api", tags=["events"])

LastEventId = Annotated[
    int | None,
    Header(alias="Last-Event-ID", ge=0, lt=2**63, description="Id of the last event seen: go on behind it"),
]


@dataclass(frozen=True)
class OfScan:
    """A stream that is about to begin."""

    scan: str
    news: News
    begin: Present | Behind
    whole: Whole
    seen: int


@dataclass(frozen=True)
class OfAll:
    """The same of everything."""

    news: News
    behind: list[ScanEvent]
    whole: Whole
    seen: int


async def _of_scan(request: Request, scan: Scan, service: Service, last: LastEventId = None) -> AsyncIterator[OfScan]:
    with _following(request, service, scan.id) as news:
        yield OfScan(scan.id, news, *await to_thread.run_sync(_begin_scan, service.store.events, scan.id, last))


async def _of_all(request: Request, service: Service, last: LastEventId = None) -> AsyncIterator[OfAll]:
    with _following(request, service, None) as news:
        yield OfAll(news, *await to_thread.run_sync(_begin_all, service.store.events, last))


CHANGES = ("state", "progress", "view", "resync")
SCAN_DATA = "`scan` and `resync` the scan as `GET /api/scans/SCAN` has it"
ALL_DATA = "`cell` and `resync` an object with the cell's `state`, `problem` and `reason`"


def _responses(names: tuple[str, ...], whole: str, *slugs: str) -> dict[int | str, dict[str, Any]]:
    described = f"""Server-sent events. Each has a name and, as JSON, its data: {whole};
those named `state`, `progress` and `view` an object with `id`, `scan`, `at`, `kind` and, as `data`, what has changed
(`state`: state, stage, fraction, problem, summary; `progress`: stage, fraction; `view`: index, state, reason).
Ids rise from change to change."""
    content = {EventStream.media_type: {"itemSchema": _event(names)}}
    return {200: {"description": described, "content": content}} | problem_responses(
        "event-unknown", "invalid-request", "not-ready", "too-many-streams", *slugs
    )


def _event(names: tuple[str, ...]) -> dict[str, Any]:
    """One event of a stream, for the API's description."""
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
    | {204: {"description": "It has ended, and all is told"}},
)
async def follow_scan(request: Request, stream: Annotated[OfScan, Depends(_of_scan)], service: Service) -> Response:
    """The scan's changes as server-sent events, up to its final state, with which the stream ends.

    First comes `scan` with the whole scan, then `state`, `progress` and `view` with what has changed. With
    `Last-Event-ID` only what has happened since. `resync` has the whole scan again, where changes in between are not
    told.
    """
    begin = stream.begin
    if isinstance(begin, Behind) and begin.over and not begin.events:
        return Response(status_code=204)  # a browser would come again and again after any other
    content = scan_stream(service.store.events, stream.scan, stream.news, begin, stream.whole, stream.seen)
    return EventStream(content, still_allowed(request))


@router.get(
    "/events",
    status_code=200,
    response_class=EventStream,
    responses=_responses((*CHANGES, "cell"), ALL_DATA),
)
async def follow_all(request: Request, stream: Annotated[OfAll, Depends(_of_all)], service: Service) -> Response:
    """The changes of all scans and of the cell as server-sent events, without an end.

    First comes `cell` with the cell's state, and again whenever that changes; `state`, `progress` and `view` are as in
    a scan's own events. With `Last-Event-ID` also what has happened to scans since. After `resync` ask for the scans
    anew: changes in between are not told.
    """
    cell, events = service.cell, service.store.events
    content = all_stream(events, lambda: cell_event(cell.status), stream.news, stream.behind, stream.whole, stream.seen)
    return EventStream(content, still_allowed(request))


@contextmanager
def _following(request: Request, service: Context, topic: str | None) -> Iterator[News]:
    """A slot, and the news from here on, until the client is gone.

    Raises:
        ProblemError: `too-many-streams`, or `not-ready` when the service is ending.
    """
    hub = service.store.events.hub
    if hub.closed:
        raise ProblemError("not-ready", "the service is stopping")
    caller = known_caller(request.scope)
    with service.streams.taken(None if caller is None or caller.local else caller.name), hub.following(topic) as news:
        yield news


def _begin_scan(events: ScanEvents, scan_id: str, last: int | None) -> tuple[Present | Behind, Whole, int]:
    """Asks the database, when the news are followed already: what it does not know yet comes by them."""
    whole: Whole = "scan"
    if last is not None:
        with _known_event():
            behind = events.behind(scan_id, last)
        if behind is not None:
            return behind, whole, last
        whole = "resync"
    present = events.present(scan_id)
    if present is None:  # removed since it was found
        raise ProblemError("scan-not-found", f"there is no scan {scan_id} any more; GET /api/scans lists them")
    return present, whole, present.newest


def _begin_all(events: ScanEvents, last: int | None) -> tuple[list[ScanEvent], Whole, int]:
    whole: Whole = "cell"
    if last is not None:
        with _known_event():
            behind = events.all_behind(last)
        if behind is not None:
            return behind, whole, last
        whole = "resync"
    return [], whole, events.newest()


@contextmanager
def _known_event() -> Iterator[None]:
    try:
        yield
    except UnknownEventError as error:
        detail = f"Last-Event-ID: {error}; leave it out to begin with the present state"
        raise ProblemError("event-unknown", detail) from error
