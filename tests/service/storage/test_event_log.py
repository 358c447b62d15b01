"""Events of scans: written with the rows and in order. A client may continue after any event without a loss."""

import asyncio
import json
import random
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import aclosing, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx2
import pytest
from anyio import to_thread

from calibration.atomic_write import write_synced
from recognition.request import RecognitionRequest
from service.api.schemas.scan_resource import scan_resource
from service.api.server_sent_events import change_event, scan_stream
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import DataFolder
from service.storage.event_log import MAX_MISSED_EVENTS, Change, ScanEvent, ScanSnapshot, UnknownEventError
from service.storage.store import Store
from tests.service.conftest import ServedClient
from tests.service.following import ReceivedEvent, fold_events, open_stream, read_events

AssertProblem = Callable[[httpx2.Response, int, str], str]
ABORTED = Failure("aborted", "so")


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(DataFolder(tmp_path)) as folder, closing(Store(folder)) as store:
        yield store


def add_scan(store: Store) -> str:
    scan = new_scan("live", RecognitionRequest(), NOBODY)
    store.scans.add(scan)
    return scan.id


def snapshot_event(store: Store, scan_id: str) -> ReceivedEvent:
    """Return the complete scan as the first event of a stream."""
    present = store.events.snapshot(scan_id)
    assert present is not None
    return ReceivedEvent("scan", str(present.newest), scan_resource(present.scan, present.views).model_dump())


def events_since(store: Store, scan_id: str, last: int = 0) -> list[ScanEvent]:
    """Return the stored events of a scan after the event `last`."""
    found = store.events.since(scan_id, last)
    assert found is not None
    return found.events


def as_received(events: list[ScanEvent]) -> list[ReceivedEvent]:
    """Return stored events as a client receives them."""
    sent = [change_event(event).decode() for event in events]
    data = [json.loads(text.partition("data: ")[2].partition("\n")[0]) for text in sent]
    return [ReceivedEvent(event.kind, str(event.id), document) for event, document in zip(events, data, strict=True)]


def test_each_change_has_its_event(store: Store) -> None:
    scan = add_scan(store)
    store.scans.update(scan, state="scanning", started_at="2026-01-02T03:04:05.678Z")
    store.scans.set_view(scan, 2, "moving")
    store.scans.set_view(scan, 2, "recorded")
    store.scans.update(scan, stage="views", fraction=0.5)
    store.scans.set_view(scan, 3, "moving")
    store.scans.update(scan, inputs={"method": "graph"})  # the inputs have no event
    store.scans.update(scan, ("processing",), stage="no such")  # nor has an update that was not applied
    store.scans.end(scan, "failed", Failure("robot-lost", "gone"))
    store.scans.end(scan, "aborted", ABORTED)
    assert not store.scans.update(scan, fraction=0.9)

    events = events_since(store, scan)
    kinds = [(event.kind, event.data.get("state"), event.data.get("index")) for event in events]
    assert kinds == [
        ("state", "connecting", None),
        ("state", "scanning", None),
        ("view", "moving", 2),
        ("view", "recorded", 2),
        ("progress", None, None),
        ("view", "moving", 3),
        ("view", "missing", 3),
        ("state", "failed", None),
    ]
    assert [event.id for event in events] == list(range(1, 9))
    assert [event.final for event in events] == [False] * 7 + [True]
    assert events[4].data == {"stage": "views", "fraction": 0.5}
    assert events[6].data["reason"]
    assert events[7].data["failure"] == {"slug": "robot-lost", "message": "gone"}
    sent = as_received(events)
    assert sent[2].data == {name: vars(events[2])[name] for name in ("id", "scan", "at", "kind", "data")}
    assert sent[7].data["data"]["problem"] == {
        "type": "urn:pointchain:robot-lost",
        "title": "The connection to the robot was lost",
        "status": 503,
        "detail": "gone",
        "instance": f"/api/scans/{scan}",
        "parameters": {},
    }


def test_a_result_and_its_event_are_written_together(store: Store) -> None:
    scan = add_scan(store)
    results = store.folder.incoming(scan)
    results.mkdir()
    write_synced(results / "model.json", b"{}")
    doubt = {"code": "possible-bar", "severity": "doubt", "message": "a bar?", "chains": [0], "value": 0.2}
    summary = {"chains": 1, "crossings": 0, "verdict": "review", "doubts": [doubt], "doubt_count": 1, "note_count": 2}
    store.scans.finish(scan, "succeeded", summary | {"partial": False}, results)
    (*_, last) = events_since(store, scan)
    assert last.final
    assert last.data["summary"] == summary | {"partial": False}
    assert as_received([last])[0].data["data"]["summary"] == summary
    assert last.data["fraction"] == 1.0


def test_a_change_that_cannot_be_written_is_not_published(store: Store) -> None:
    scan = add_scan(store)

    async def changes() -> None:
        with store.events.hub.subscribe(scan) as news:
            for change in (
                lambda: store.scans.update(scan, state="scanning"),
                lambda: store.scans.set_view(scan, 0, "moving"),
                lambda: store.scans.end(scan, "aborted", ABORTED),
            ):
                with (
                    patch.object(Change, "_add", side_effect=OSError("the disk")),
                    pytest.raises(OSError, match="the disk"),
                ):
                    change()
            assert await news.next(0.05) is None

    asyncio.run(changes())
    present = store.events.snapshot(scan)
    assert present is not None
    assert (present.scan.state, present.views, present.newest) == ("connecting", [], 1)
    store.scans.update(scan, state="scanning")
    assert [event.id for event in events_since(store, scan)] == [1, 2]  # the ids have no gap


def test_an_event_is_on_the_disk_before_it_is_published(store: Store, tmp_path: Path) -> None:
    scan, published_ids = add_scan(store), []

    def publish(_: str, event: ScanEvent) -> None:
        with closing(Store(store.folder)) as another:
            published_ids.append((event.id, [one.id for one in events_since(another, scan)][-1]))

    with patch.object(store.events.hub, "publish", publish):
        store.scans.set_view(scan, 0, "moving")
        store.scans.update(scan, state="scanning")
    assert published_ids == [(2, 2), (3, 3)]


def test_the_later_events_complete_every_earlier_snapshot(store: Store) -> None:
    scan, snapshots = add_scan(store), []
    for number in range(6):
        snapshots.append(snapshot_event(store, scan))
        store.scans.set_view(scan, number // 2, "recorded" if number % 2 else "moving")
        snapshots.append(snapshot_event(store, scan))
        store.scans.update(scan, stage="views", fraction=number / 6)
        add_scan(store)  # other scans have events in between
    store.scans.end(scan, "aborted", ABORTED)
    for before in snapshots:
        after = as_received(events_since(store, scan, int(before.id)))
        assert fold_events([before, *after]) == fold_events([snapshot_event(store, scan)])


def test_unknown_events_are_refused_and_removed_events_have_no_continuation(store: Store) -> None:
    scan, other = add_scan(store), add_scan(store)
    store.scans.update(scan, state="scanning")
    for last in (4, 2**62):
        with pytest.raises(UnknownEventError, match="no event"):
            store.events.since(scan, last)
        with pytest.raises(UnknownEventError, match="no event"):
            store.events.all_since(last)
    with pytest.raises(UnknownEventError, match="not of this scan"):
        store.events.since(scan, 2)
    everything = store.events.all_since(0)
    assert everything is not None
    assert [event.scan for event in everything] == [scan, other, scan]
    with store.database.transaction() as db:
        db.execute("DELETE FROM events WHERE scan = ?", (other,))
    assert store.events.all_since(0) is None
    assert store.events.all_since(2) is not None
    assert store.events.since(scan, 2) is None
    assert store.events.newest() == 3
    assert store.events.snapshot("no-such") is None
    with store.database.transaction() as db:
        db.execute("DELETE FROM events")
    assert store.events.newest() == 3
    assert store.events.all_since(2) is None


def test_too_many_missed_events_of_all_scans_are_not_returned(store: Store) -> None:
    scan = add_scan(store)
    with store.events.transaction() as change:
        for _ in range(MAX_MISSED_EVENTS):
            change.progress(scan)
    assert store.events.all_since(0) is None
    found = store.events.all_since(1)
    assert found is not None
    assert len(found) == MAX_MISSED_EVENTS


def test_an_interruption_at_the_next_start_has_its_events(store: Store) -> None:
    scan = add_scan(store)
    store.scans.set_view(scan, 0, "moving")
    store.scans.interrupt_unfinished("~")
    assert [event.data["state"] for event in events_since(store, scan, 2)] == ["missing", "interrupted"]


def test_concurrent_changes_reach_each_follower_once_and_in_order(store: Store) -> None:
    """Two threads change each of three scans, while 21 followers disconnect and reconnect at random."""
    scans, rng = [add_scan(store) for _ in range(3)], random.Random(5)

    def change(scan: str, thread: int) -> None:
        for number in range(40):
            if number % 3:
                store.scans.set_view(scan, 8 * thread + number % 8, "recorded" if number % 2 else "moving")
            else:
                store.scans.update(scan, stage=f"{thread}", fraction=number / 40)

    def change_all(scan: str) -> None:
        halves = [threading.Thread(target=change, args=(scan, half)) for half in range(2)]
        for half in halves:
            half.start()
        for half in halves:
            half.join()
        store.scans.end(scan, "aborted", ABORTED)

    async def follow(scan: str) -> list[ReceivedEvent]:
        """Return the snapshot and all later changes, received over several connections."""
        found: list[ReceivedEvent] = []
        while not found or not final(found[-1]):
            async for event in connect_once(scan, int(found[-1].id) if found else None):
                found.append(event)
                if rng.random() < 0.05:
                    break
        return found

    async def connect_once(scan: str, last: int | None) -> AsyncIterator[ReceivedEvent]:
        events = store.events
        with events.hub.subscribe(scan) as news:
            if last is None:
                begin = await to_thread.run_sync(events.snapshot, scan)
            else:
                begin = await to_thread.run_sync(events.since, scan, last)
            assert begin is not None
            seen = begin.newest if isinstance(begin, ScanSnapshot) else last or 0
            async with aclosing(scan_stream(events, scan, news, begin, "scan", seen)) as stream:
                async for chunk in stream:
                    if (event := parsed(chunk)) is not None:
                        yield event

    async def run_all() -> list[tuple[str, list[ReceivedEvent]]]:
        followers = [(scan, asyncio.create_task(follow(scan))) for scan in scans for _ in range(7)]
        writers = [asyncio.create_task(asyncio.to_thread(change_all, scan)) for scan in scans]
        found = [(scan, await follower) for scan, follower in followers]
        await asyncio.gather(*writers)
        return found

    for scan, (first, *changes) in asyncio.run(asyncio.wait_for(run_all(), 120)):
        assert first.kind == "scan"
        ids, written = [int(event.id) for event in changes], [event.id for event in events_since(store, scan)]
        assert ids == written[written.index(int(first.id)) + 1 :]
        assert fold_events([first, *changes]) == fold_events([snapshot_event(store, scan)])


def parsed(chunk: bytes) -> ReceivedEvent | None:
    """Return the event of a chunk of a stream, or None if the chunk has no event."""
    fields = dict(line.split(": ", 1) for line in chunk.decode().splitlines() if line)
    return (
        ReceivedEvent(fields["event"], fields.get("id", ""), json.loads(fields["data"])) if "data" in fields else None
    )


def final(event: ReceivedEvent) -> bool:
    """Return whether an event has the final state of these tests."""
    return event.kind == "state" and event.data["data"]["state"] == "aborted"


@dataclass(frozen=True)
class FollowedScan:
    """An ended scan, with all events of its stream."""

    path: str
    events: list[ReceivedEvent]
    document: dict[str, Any]


@pytest.fixture(scope="module")
def followed(client: httpx2.Client, recording_file: Path) -> FollowedScan:
    return followed_scan(client, recording_file)


def followed_scan(client: httpx2.Client, recording_file: Path) -> FollowedScan:
    """Return a new scan of the recording, followed until its end."""
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    scan = client.post("/api/scans", json={"mode": "replay", "recording": recording}).json()
    events = read_events(client, scan["links"]["events"])
    return FollowedScan(scan["links"]["events"], events, client.get(scan["links"]["self"]).json())


def test_a_stream_has_all_events_of_a_scan(client: httpx2.Client, followed: FollowedScan) -> None:
    first, *changes = followed.events
    assert first.kind == "scan"
    assert {change.kind for change in changes} == {"state", "progress"}
    assert changes[-1].data["data"]["state"] == followed.document["state"] == "succeeded"
    ids = [int(event.id) for event in followed.events]
    assert ids == sorted(set(ids))
    for change in changes:
        assert change.data.keys() == {"id", "scan", "at", "kind", "data"}
        described = tuple(change.data[name] for name in ("id", "scan", "kind"))
        assert described == (int(change.id), followed.document["id"], change.kind)
    # A new stream has only the snapshot, which has all changes.
    assert read_events(client, followed.path) == [ReceivedEvent("scan", changes[-1].id, followed.document)]
    assert fold_events(followed.events) == fold_events([ReceivedEvent("scan", "", followed.document)])


def test_a_stream_continues_after_any_event(client: httpx2.Client, followed: FollowedScan) -> None:
    for number, event in enumerate(followed.events[:-1]):
        assert read_events(client, followed.path, event.id) == followed.events[number + 1 :]
    # After the last event, the answer is 204, which ends the reconnections of a browser.
    assert client.get(followed.path, headers={"Last-Event-ID": followed.events[-1].id}).status_code == 204


def test_the_stream_of_all_events_has_the_cell_and_each_change(client: httpx2.Client, followed: FollowedScan) -> None:
    with open_stream(client, "/api/events") as events:
        cell = next(events)
        assert cell.kind == "cell"
        assert cell.data == {name: client.get("/api/cell").json()[name] for name in ("state", "problem", "reason")}
        body = {"mode": "replay", "recording": followed.document["recording"]}
        scan = client.post("/api/scans", json=body).json()
        changes = [next(events)]
        while changes[-1].data["data"].get("state") != "succeeded":
            changes.append(next(events))
    assert {change.data["scan"] for change in changes} == {scan["id"]}
    assert [int(change.id) for change in changes] == list(range(int(cell.id) + 1, int(changes[-1].id) + 1))
    with open_stream(client, "/api/events", last=cell.id) as events:
        assert next(events) == cell
        assert [next(events) for _ in changes] == changes


def test_a_stream_has_its_headers_and_retry_time(client: httpx2.Client, followed: FollowedScan) -> None:
    answer = client.get(followed.path)
    assert answer.headers["content-type"] == "text/event-stream; charset=utf-8"
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["x-accel-buffering"] == "no"
    assert answer.text.startswith("retry: 2000\n\n")


@pytest.mark.parametrize("last", ["", "abc", "-1", "1.5", str(2**63), str(2**70)])
def test_an_invalid_event_id_is_refused(
    client: httpx2.Client, followed: FollowedScan, assert_problem: AssertProblem, last: str
) -> None:
    for path in (followed.path, "/api/events"):
        assert_problem(client.get(path, headers={"Last-Event-ID": last}), 422, "invalid-request")


@pytest.mark.problem("event-unknown")
def test_an_unknown_event_is_refused(
    client: httpx2.Client, followed: FollowedScan, assert_problem: AssertProblem
) -> None:
    for path in (followed.path, "/api/events"):
        for last in (10**6, 2**63 - 1):
            assert_problem(client.get(path, headers={"Last-Event-ID": str(last)}), 422, "event-unknown")
    assert_problem(client.get("/api/scans/no-such/events"), 404, "scan-not-found")


def test_a_stream_after_a_removed_event_begins_with_the_present_state(
    client: ServedClient, recording_file: Path
) -> None:
    followed = followed_scan(client, recording_file)
    database = client.app.state.context.store.database
    with database.transaction() as db:
        db.execute("DELETE FROM events WHERE id = ?", (followed.events[1].id,))
    assert read_events(client, followed.path, followed.events[1].id) == [
        ReceivedEvent("resync", followed.events[-1].id, followed.document)
    ]
    with open_stream(client, "/api/events", last=0) as events:
        assert next(events).kind == "resync"
