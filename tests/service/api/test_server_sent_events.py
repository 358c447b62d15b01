"""Event streams are limited by slots, and a client that does not read harms no other."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from itertools import islice

import httpx2
import pytest

from cell.control.status import CellStatus
from recognition.request import RecognitionRequest
from service.api import server_sent_events
from service.api.dependencies import Context
from service.errors import Failure, ServiceError
from service.events.hub import MAX_BACKLOG
from service.events.stream_slots import StreamSlots
from service.jobs.submission import NOBODY, new_scan
from service.security.auth.tokens import TOKENS_FILE, add_token, read_tokens, remove_token
from service.server import uvicorn_server
from tests.service.cell_status import status_with_arm
from tests.service.conftest import PATIENCE_S, Serve, ServedClient, wait_until
from tests.service.following import fold_events, open_stream, read_events

SLOTS = 4
STALLED_S = 1.0
# together more than the system buffers for a connection, which is some MB on each side
PIECES, PIECE = 130, "x" * 250_000

AssertProblem = Callable[[httpx2.Response, int, str], str]


@pytest.fixture(scope="module")
def quick(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """Start a service with few slots, which soon drops clients that do not read."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(uvicorn_server, "STALLED_S", STALLED_S)
        with serve(tmp_path_factory.mktemp("data"), limits={"event_streams": SLOTS, "event_streams_each": 2}) as client:
            yield client


@pytest.fixture
def service(quick: ServedClient) -> Iterator[Context]:
    """Yield the context of the service. At the end, no stream may be open."""
    context = quick.app.state.context
    yield context
    wait_until(lambda: context.streams.open == 0)
    assert context.store.events.hub.subscribers == 0


@pytest.fixture
def scan(service: Context) -> str:
    """Add a scan that only the test changes."""
    scan = new_scan("live", RecognitionRequest(), NOBODY)
    service.store.scans.add(scan)
    return scan.id


@contextmanager
def stalled_client(client: httpx2.Client, path: str) -> Iterator[socket.socket]:
    """Connect a client that reads only the beginning of its stream."""
    host, port = client.base_url.host, client.base_url.port
    with socket.create_connection((host, port or 80)) as connection:
        connection.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
        assert b"200 OK" in connection.recv(64)
        yield connection


def end(service: Context, scan: str) -> None:
    service.store.scans.end(scan, "aborted", Failure("aborted", "so"))


def test_slots_are_limited_in_total_and_per_caller() -> None:
    slots = StreamSlots(4, 2)
    with ExitStack() as slots_taken:
        for caller in ("ann", "ann", "bob"):
            slots_taken.enter_context(slots.acquire(caller))
        with pytest.raises(ServiceError, match="you follow 2 event streams") as refused:
            slots_taken.enter_context(slots.acquire("ann"))
        assert (refused.value.slug, refused.value.retry_after_s) == ("too-many-streams", 5.0)
        slots_taken.enter_context(slots.acquire("bob"))
        with pytest.raises(ServiceError, match="4 event streams are open"):
            slots_taken.enter_context(slots.acquire("eve"))
        assert slots.open == 4
    assert slots.open == 0
    with ExitStack() as slots_taken:  # without tokens, only the total is limited
        for _ in range(4):
            slots_taken.enter_context(slots.acquire(None))
        with pytest.raises(ServiceError, match="4 event streams"):
            slots_taken.enter_context(slots.acquire(None))


@pytest.mark.problem("too-many-streams")
def test_a_stream_beyond_the_limit_is_refused_until_a_slot_is_free(
    quick: ServedClient, service: Context, scan: str, assert_problem: AssertProblem
) -> None:
    path = f"/api/scans/{scan}/events"
    with ExitStack() as streams_open:
        streams = [streams_open.enter_context(open_stream(quick, path)) for _ in range(SLOTS - 1)]
        assert [next(events).kind for events in streams] == ["scan"] * (SLOTS - 1)
        with open_stream(quick, "/api/events") as last:
            next(last)
            assert service.streams.open == SLOTS
            for one in (path, "/api/events"):
                answer = quick.get(one)
                assert_problem(answer, 503, "too-many-streams")
                assert int(answer.headers["retry-after"]) > 0
            assert quick.get("/api/scans").status_code == 200  # other requests still work
        wait_until(lambda: service.streams.open == SLOTS - 1)
        with open_stream(quick, path) as another:
            assert next(another).kind == "scan"
    assert_problem(quick.get("/api/scans/no-such/events"), 404, "scan-not-found")
    assert_problem(quick.get(path, headers={"Last-Event-ID": "1000000"}), 422, "event-unknown")


def test_each_token_has_its_own_slots(quick: ServedClient, service: Context, assert_problem: AssertProblem) -> None:
    data = service.store.folder.root
    callers = [{"Authorization": f"Bearer {add_token(data, name, 'viewer')}"} for name in ("ann", "bob")]
    try:
        with ExitStack() as streams_open:
            for _ in range(2):
                answer = streams_open.enter_context(quick.stream("GET", "/api/events", headers=callers[0]))
                assert answer.status_code == 200
            detail = assert_problem(quick.get("/api/events", headers=callers[0]), 503, "too-many-streams")
            assert "you follow 2" in detail
            with quick.stream("GET", "/api/events", headers=callers[1]) as answer:
                assert answer.status_code == 200
    finally:
        for name in ("ann", "bob"):
            remove_token(data, name)


def test_a_client_that_does_not_read_is_dropped_and_delays_no_other(
    quick: ServedClient, service: Context, scan: str
) -> None:
    path = f"/api/scans/{scan}/events"
    with stalled_client(quick, path), stalled_client(quick, path), ThreadPoolExecutor(1) as pool:
        reading = pool.submit(read_events, quick, path)
        wait_until(lambda: service.streams.open == 3)
        backlogs = list(service.store.events.hub._subscribers)
        for number in range(PIECES):
            service.store.scans.update(scan, stage=PIECE, fraction=number / PIECES)
        assert quick.post("/api/cell/stop").status_code == 200
        end(service, scan)
        # a client that reads gets the end while the others read nothing
        assert fold_events(reading.result(PATIENCE_S))["state"] == "aborted"
        assert all(len(backlog._waiting) <= MAX_BACKLOG + 1 for backlog in backlogs)
        wait_until(lambda: service.streams.open == 0)


def publish_beyond_backlog(service: Context, scan: str) -> None:
    """Publish more events than a backlog holds, before any subscriber can take one."""

    def change() -> None:
        with service.store.events.transaction() as change:
            for _ in range(3 * MAX_BACKLOG):
                change.progress(scan)
        done.set()

    done, loop = threading.Event(), service.store.events.hub._loop
    assert loop is not None
    loop.call_soon_threadsafe(change)
    assert done.wait(PATIENCE_S)


def test_a_slow_client_gets_a_resync(quick: ServedClient, service: Context, scan: str) -> None:
    path = f"/api/scans/{scan}/events"
    with open_stream(quick, path) as events:
        begin = next(events)
        service.store.scans.set_view(scan, 0, "recorded")
        change = next(events)
        publish_beyond_backlog(service, scan)
        again = next(events)
        service.store.scans.set_view(scan, 1, "moving")
        end(service, scan)
        rest = list(events)
    assert [event.kind for event in (begin, change, again, *rest)] == [
        "scan",
        "view",
        "resync",
        "view",
        "view",
        "state",
    ]
    assert int(again.id) == int(change.id) + 3 * MAX_BACKLOG
    assert fold_events([again, *rest]) == fold_events([begin, change, *rest]) == fold_events(read_events(quick, path))


def test_keep_alive_comments_are_sent(
    quick: ServedClient, service: Context, scan: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_sent_events, "PING_S", 0.05)
    for path in (f"/api/scans/{scan}/events", "/api/events"):
        with quick.stream("GET", path) as answer:
            lines = answer.iter_lines()
            while next(lines) != ": ping":
                pass


def test_all_events_have_the_cell_and_a_resync_after_too_many_changes(
    quick: ServedClient, service: Context, scan: str
) -> None:
    with open_stream(quick, "/api/events") as events:
        first = next(events)
        service.cell._status.change(state="fault", slug="robot-lost", reason="gone")
        service.cell._status.change(arm=None)  # not an event
        service.cell._status.change(state="not_ready", slug="stopped", reason="by request")
        changes = [next(events), next(events)]
        assert [change.data for change in changes] == [
            {"state": "fault", "problem": "urn:pointchain:robot-lost", "reason": "gone"},
            {"state": "not_ready", "problem": "urn:pointchain:stopped", "reason": "by request"},
        ]
        # cell events are not stored and have no id of their own
        assert [change.id for change in changes] == [first.id] * 2
        publish_beyond_backlog(service, scan)
        again = next(events)
        assert (again.kind, again.data) == ("resync", changes[-1].data)
        assert int(again.id) == service.store.events.newest()
        end(service, scan)
        assert next(events).kind == "state"


def test_a_stream_has_the_joint_angles_of_a_moving_arm_on_request(
    quick: ServedClient, service: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    angles = [0.0]

    def status() -> CellStatus:
        return status_with_arm("busy", angles[0], moving=True)

    monkeypatch.setattr(type(service.cell), "status", property(lambda cell: status()))
    with open_stream(quick, "/api/events?arm=true") as events:
        assert next(events).kind == "cell"
        times = []
        for step in range(1, 6):
            angles[0] = step / 10 + 1e-6  # less than the noise of an arm at rest
            event = next(events)
            times.append(time.monotonic())
            assert (event.kind, event.data) == ("arm", {"q_rad": [step / 10] * 6, "moving": True})
        assert (times[-1] - times[0]) / 4 < 0.2  # at least 5 Hz
    with open_stream(quick, "/api/events") as events:
        assert next(events).kind == "cell"
        angles[0] = 1.0
        service.cell._status.change(state="not_ready", slug="stopped", reason="without arm events")
        assert next(events).kind == "cell"


def rest_of(lines: Iterator[str]) -> list[str]:
    """Return the remaining lines of a stream, which must end."""
    found = list(islice(lines, 200))
    assert len(found) < 200, "the stream does not end"
    return found


def test_a_stream_ends_when_its_client_is_no_longer_allowed(
    quick: ServedClient, service: Context, scan: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_sent_events, "PING_S", 0.05)
    data, paths = service.store.folder.root, (f"/api/scans/{scan}/events", "/api/events")
    with ExitStack() as streams_open:

        def open_streams(headers: dict[str, str]) -> list[Iterator[str]]:
            begun = [
                streams_open.enter_context(quick.stream("GET", path, headers=headers)).iter_lines() for path in paths
            ]
            for lines in begun:
                while not next(lines).startswith("data: "):
                    pass
            return begun

        without_token = open_streams({})
        ann, bob = ({"Authorization": f"Bearer {add_token(data, name, 'viewer')}"} for name in ("ann", "bob"))
        try:
            # tokens exist now, so a client without one is no longer allowed
            service.store.scans.set_view(scan, 0, "recorded")
            assert not any("recorded" in line for lines in without_token for line in rest_of(lines))
            wait_until(lambda: service.streams.open == 0)

            of_ann, of_bob = open_streams(ann), open_streams(bob)
            remove_token(data, "ann")
            service.store.scans.set_view(scan, 1, "moving")
            assert not any("moving" in line for lines in of_ann for line in rest_of(lines))
            for lines in of_bob:
                while "moving" not in next(lines):
                    pass
            wait_until(lambda: service.streams.open == 2)
            remove_token(data, "bob")  # without an event, so the next keep-alive comment ends the stream
            for lines in of_bob:
                rest_of(lines)
        finally:
            for token in read_tokens(data / TOKENS_FILE):
                remove_token(data, token.name)
