"""Events as server-sent events: what has been, then what comes, without a gap and none twice."""

import json
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import aclosing
from typing import Literal

from anyio import to_thread
from fastapi.responses import StreamingResponse
from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from service.api.schemas.addresses import SCANS
from service.api.schemas.scan_resource import scan_resource
from service.api.schemas.scans import ScanSummary
from service.errors import Failure
from service.events.cell_events import CellEvent
from service.events.hub import Follower, Mark
from service.problems.document import failure_document
from service.storage.event_log import Behind, Present, ScanEvent, ScanEvents

PING_S = 15.0
"""After so long without an event a comment is sent, lest something on the way takes the connection for dead."""
RETRY = format_sse_event(retry=2000)
"""A client that has lost the stream tries again after so many milliseconds."""
ENDING = format_sse_event(comment="the service is stopping")

News = Follower[ScanEvent | CellEvent]
Whole = Literal["scan", "cell", "resync"]
"""Events that tell how things stand, not what has changed. `resync`: some changes in between are not told."""


class EventStream(StreamingResponse):
    """An answer that goes on for as long as its content, its client, or the client's right to it does."""

    # Not fastapi.sse's own way, a route that yields: it has no say in the headers and the pings, and keeps three tasks
    # and two queues for each client.
    media_type = "text/event-stream"

    def __init__(self, content: AsyncGenerator[bytes], allowed: Callable[[], bool]) -> None:
        """`allowed` is asked before each event and each sign of life."""
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(_while_allowed(content, allowed), headers=headers)


async def _while_allowed(content: AsyncGenerator[bytes], allowed: Callable[[], bool]) -> AsyncIterator[bytes]:
    async with aclosing(content):
        async for piece in content:
            if not allowed():  # its token was removed, or it had none and there is one now
                return
            yield piece


async def scan_stream(
    events: ScanEvents, scan_id: str, news: News, begin: Present | Behind, whole: Whole, seen: int
) -> AsyncGenerator[bytes]:
    """The events of one scan up to its last. `news` of the scan are followed since before `begin` was read.

    `whole`: as what a `begin` that is the present state is told. `seen`: the newest event in that, or the one that
    `begin` has the changes behind.
    """
    yield RETRY
    if isinstance(begin, Present):
        yield _present(whole, begin)
    else:
        for event in begin.events:
            yield change_event(event)
            seen = event.id
    over = begin.over
    while not over:
        item = await news.next(PING_S)
        if item is None:
            yield KEEPALIVE_COMMENT
        elif item is Mark.CLOSED:
            yield ENDING
            return
        elif item is Mark.MISSED:
            present = await to_thread.run_sync(events.present, scan_id)
            if present is None:  # removed, so it had ended
                return
            yield _present("resync", present)
            seen, over = present.newest, present.over
        elif isinstance(item, ScanEvent) and item.id > seen:
            yield change_event(item)
            seen, over = item.id, item.final


async def all_stream(
    events: ScanEvents, cell: Callable[[], CellEvent], news: News, behind: list[ScanEvent], whole: Whole, seen: int
) -> AsyncGenerator[bytes]:
    """The events of all scans, and the cell's; it does not end by itself. `news` are followed since before `behind`,
    the events since the one that the client has `seen`, were read.

    `cell` tells the state that the cell is in; its events have no id but where they tell how things stand.
    """
    yield RETRY
    yield _cell(whole, cell(), seen)
    for event in behind:
        yield change_event(event)
        seen = event.id
    while True:
        item = await news.next(PING_S)
        if item is None:
            yield KEEPALIVE_COMMENT
        elif item is Mark.CLOSED:
            yield ENDING
            return
        elif item is Mark.MISSED:
            seen = await to_thread.run_sync(events.newest)
            yield _cell("resync", cell(), seen)
        elif isinstance(item, CellEvent):
            yield _cell("cell", item)
        elif isinstance(item, ScanEvent) and item.id > seen:
            yield change_event(item)
            seen = item.id


def change_event(event: ScanEvent) -> bytes:
    """Return one change of a scan as a server-sent event. A failure and a summary are as in the scan's resource."""
    data = dict(event.data)
    if event.kind == "state":
        failure, summary = data.pop("failure", None), data.pop("summary", None)
        problem = None if failure is None else failure_document(Failure(**failure), f"{SCANS}/{event.scan}")
        known = None if summary is None else ScanSummary.model_validate(summary).model_dump()
        data |= {"problem": problem, "summary": known}
    document = {"id": event.id, "scan": event.scan, "at": event.at, "kind": event.kind, "data": data}
    return format_sse_event(data_str=json.dumps(document, allow_nan=False), event=event.kind, id=str(event.id))


def _present(kind: Whole, present: Present) -> bytes:
    resource = scan_resource(present.scan, present.views)
    return format_sse_event(data_str=resource.model_dump_json(), event=kind, id=str(present.newest))


def _cell(kind: Whole, event: CellEvent, seen: int | None = None) -> bytes:
    return format_sse_event(data_str=event.text, event=kind, id=None if seen is None else str(seen))
