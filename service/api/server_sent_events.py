"""Streams of server-sent events: the past changes, then each new one, without gaps or duplicates."""

import json
import time
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
from service.events.cell_events import ArmEvent, CellEvent
from service.events.hub import Mark, Subscriber
from service.problems.document import failure_document
from service.states import ACTIVE_STATES
from service.storage.event_log import MissedEvents, ScanEvent, ScanEvents, ScanSnapshot

PING_S = 15.0
"""Time without an event after which a comment is sent, so that no proxy drops the connection as idle."""
ARM_PERIOD_S = 0.1
"""Period at which the posture of the arm is read for a stream that has it."""
RETRY = format_sse_event(retry=2000)
"""Tells a client to reconnect 2000 ms after it has lost the stream."""
STOPPING_COMMENT = format_sse_event(comment="the service is stopping")

EventSubscriber = Subscriber[ScanEvent | CellEvent]
SnapshotKind = Literal["scan", "cell", "resync"]
"""Names of events with a whole state in place of a change. Before `resync`, some changes were not sent."""


class EventStream(StreamingResponse):
    """A streaming response that ends with its content, its connection, or the client's permission to read it."""

    # not a generator route of fastapi.sse, which fixes the headers and pings and keeps 3 tasks and 2 queues per client
    media_type = "text/event-stream"

    def __init__(self, content: AsyncGenerator[bytes], allowed: Callable[[], bool]) -> None:
        """Create the stream.

        Args:
            content: The events as bytes.
            allowed: Whether the client may still read. Called before each event and each keep-alive comment.
        """
        headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        super().__init__(_while_allowed(content, allowed), headers=headers)


async def _while_allowed(content: AsyncGenerator[bytes], allowed: Callable[[], bool]) -> AsyncIterator[bytes]:
    async with aclosing(content):
        async for piece in content:
            if not allowed():  # the token was removed, or the client has none and tokens exist now
                return
            yield piece


async def scan_stream(
    events: ScanEvents,
    scan_id: str,
    subscriber: EventSubscriber,
    begin: ScanSnapshot | MissedEvents,
    snapshot_kind: SnapshotKind,
    last_id: int,
) -> AsyncGenerator[bytes]:
    """Yield the events of one scan up to its last.

    Args:
        events: The stored events.
        scan_id: Id of the scan.
        subscriber: Subscribed to the scan since before `begin` was read.
        begin: The present state, or the changes since the event `last_id`.
        snapshot_kind: Event name for a `begin` that is the present state.
        last_id: Id of the newest event in the present state, or of the event that the changes follow.
    """
    yield RETRY
    if isinstance(begin, ScanSnapshot):
        yield _scan_snapshot(snapshot_kind, begin)
    else:
        for event in begin.events:
            yield change_event(event)
            last_id = event.id
    ended = begin.ended
    while not ended:
        item = await subscriber.next(PING_S)
        if item is None:
            yield KEEPALIVE_COMMENT
        elif item is Mark.CLOSED:
            yield STOPPING_COMMENT
            return
        elif item is Mark.MISSED:
            present = await to_thread.run_sync(events.snapshot, scan_id)
            if present is None:  # removed, so it had ended
                return
            yield _scan_snapshot("resync", present)
            last_id, ended = present.newest, present.ended
        elif isinstance(item, ScanEvent) and item.id > last_id:
            yield change_event(item)
            last_id, ended = item.id, item.final


async def all_stream(
    events: ScanEvents,
    cell: Callable[[], CellEvent],
    arm: Callable[[], ArmEvent] | None,
    subscriber: EventSubscriber,
    missed: list[ScanEvent],
    snapshot_kind: SnapshotKind,
    last_id: int,
) -> AsyncGenerator[bytes]:
    """Yield the events of all scans and of the cell, without an end.

    Events of the cell have an id only at the beginning and after a `resync`.

    Args:
        events: The stored events.
        cell: Returns the present state of the cell.
        arm: Returns the present posture of the arm, of which each change is sent too. None: it is not sent.
        subscriber: Subscribed to everything since before `missed` was read.
        missed: The events of scans after the event `last_id`.
        snapshot_kind: Name of the first event.
        last_id: Id of the last event that the client has received.
    """
    yield RETRY
    yield _cell_event(snapshot_kind, cell(), last_id)
    for event in missed:
        yield change_event(event)
        last_id = event.id
    sent_arm: ArmEvent | None = None
    sent_at = time.monotonic()
    while True:
        item = await subscriber.next(PING_S if arm is None else ARM_PERIOD_S)
        if item is None:
            posture = None if arm is None else arm()
            if posture is not None and posture != sent_arm:
                sent_arm = posture
                yield format_sse_event(data_str=posture.text, event="arm")
            elif arm is None or time.monotonic() - sent_at >= PING_S:
                yield KEEPALIVE_COMMENT
            else:
                continue
        elif item is Mark.CLOSED:
            yield STOPPING_COMMENT
            return
        elif item is Mark.MISSED:
            last_id = await to_thread.run_sync(events.newest)
            yield _cell_event("resync", cell(), last_id)
        elif isinstance(item, CellEvent):
            yield _cell_event("cell", item)
        elif item.id > last_id:
            yield change_event(item)
            last_id = item.id
        sent_at = time.monotonic()


def change_event(event: ScanEvent) -> bytes:
    """Return one change of a scan as a server-sent event. Failure and summary have the form of the scan resource."""
    data = dict(event.data)
    if event.kind == "state":
        failure, summary = data.pop("failure", None), data.pop("summary", None)
        problem = None if failure is None else failure_document(Failure(**failure), f"{SCANS}/{event.scan}")
        summary_data = None if summary is None else ScanSummary.model_validate(summary).model_dump()
        data |= {"final": data["state"] not in ACTIVE_STATES, "problem": problem, "summary": summary_data}
    document = {"id": event.id, "scan": event.scan, "at": event.at, "kind": event.kind, "data": data}
    return format_sse_event(data_str=json.dumps(document, allow_nan=False), event=event.kind, id=str(event.id))


def _scan_snapshot(kind: SnapshotKind, present: ScanSnapshot) -> bytes:
    resource = scan_resource(present.scan, present.views)
    return format_sse_event(data_str=resource.model_dump_json(), event=kind, id=str(present.newest))


def _cell_event(kind: SnapshotKind, event: CellEvent, last_id: int | None = None) -> bytes:
    return format_sse_event(data_str=event.text, event=kind, id=None if last_id is None else str(last_id))
