"""The most frequent routes have threads and a cache of their own, and answer as FastAPI would."""

import asyncio
import gc
import threading
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import httpx2
import pytest
from starlette.responses import Response

from service.api.response_cache import MAX_ENTRIES, MAX_ENTRY_BYTES, ResponseCache
from service.api.schemas.scans import ScanList
from service.storage.database import Database
from service.storage.store import Store
from tests.service.conftest import PATIENCE_S, wait_until

SHARED_THREADS = 40
"""Number of Starlette threads, which all plain routes share."""


def test_cached_routes_answer_while_all_shared_threads_are_blocked(
    client: httpx2.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, go_on = threading.Semaphore(0), threading.Event()

    def hold(*_: object) -> list[object]:
        held.release()
        assert go_on.wait(PATIENCE_S)
        return []

    with ThreadPoolExecutor(SHARED_THREADS) as pool, monkeypatch.context() as patched:
        patched.setattr(Store, "recordings", hold)
        waiting = [pool.submit(client.get, "/api/recordings") for _ in range(SHARED_THREADS)]
        try:
            for _ in range(SHARED_THREADS):
                assert held.acquire(timeout=PATIENCE_S)
            assert ScanList.model_validate_json(client.get("/api/scans").content).next is None
            assert client.get("/api/cell").json()["state"] == "not_ready"
        finally:
            go_on.set()
        wait_until(lambda: all(one.done() for one in waiting))
    assert {one.result().status_code for one in waiting} == {200}


def test_errors_of_cached_routes_are_problem_documents(client: httpx2.Client) -> None:
    answer = client.get("/api/scans/none")
    assert (answer.status_code, answer.json()["type"]) == (404, "urn:pointchain:scan-not-found")
    assert client.get("/api/scans/none/model").status_code == 404
    assert client.get("/api/scans").headers["content-type"] == "application/json"


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    with closing(Database(tmp_path / "store.db")) as database:
        yield database


class CountingReader:
    """Reader that counts its calls. `hold` blocks them until it is set."""

    def __init__(self) -> None:
        self.times = 0
        self.hold: threading.Event | None = None

    def __call__(self) -> Response:
        self.times += 1
        if self.hold is not None:
            assert self.hold.wait(PATIENCE_S)
        return Response(str(self.times))


def test_an_unchanged_value_is_read_once(database: Database) -> None:
    async def request(cache: ResponseCache, read: CountingReader) -> list[bytes | memoryview]:
        seen = [(await cache.respond("x", read)).body for _ in range(3)]
        with database.transaction():
            pass
        return [*seen, (await cache.respond("x", read)).body]

    with closing(ResponseCache(database)) as cache:
        assert asyncio.run(request(cache, CountingReader())) == [b"1", b"1", b"1", b"2"]


def test_an_expired_value_is_read_again(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.api.response_cache.MAX_AGE_S", -1.0)

    async def request(cache: ResponseCache, read: CountingReader) -> list[bytes | memoryview]:
        return [(await cache.respond("x", read)).body for _ in range(2)]

    with closing(ResponseCache(database)) as cache:
        assert asyncio.run(request(cache, CountingReader())) == [b"1", b"2"]


def test_concurrent_requests_share_one_read_even_if_the_first_disconnects(database: Database) -> None:
    async def request(cache: ResponseCache, read: CountingReader) -> list[bytes | memoryview]:
        read.hold = threading.Event()
        first, *others = [asyncio.ensure_future(cache.respond("x", read)) for _ in range(5)]
        await asyncio.sleep(0.02)
        first.cancel()
        await asyncio.sleep(0)
        read.hold.set()
        return [answer.body for answer in await asyncio.gather(*others)]

    with closing(ResponseCache(database)) as cache:
        assert asyncio.run(request(cache, CountingReader())) == [b"1"] * 4


def test_neither_failures_nor_large_responses_are_kept(database: Database) -> None:
    large = CountingReader()

    def fail() -> Response:
        raise ValueError("temporary")

    def read_large() -> Response:
        return Response(bytes(large().body) * (MAX_ENTRY_BYTES + 1))

    async def request(cache: ResponseCache) -> bytes | memoryview:
        with pytest.raises(ValueError, match="temporary"):
            await cache.respond("x", fail)
        for _ in range(2):
            await cache.respond("y", read_large)
        return (await cache.respond("x", CountingReader())).body

    with closing(ResponseCache(database)) as cache:
        assert asyncio.run(request(cache)) == b"1"
    assert large.times == 2


def test_the_number_of_entries_is_limited(database: Database) -> None:
    async def request(cache: ResponseCache, read: CountingReader) -> None:
        for what in (*range(MAX_ENTRIES + 1), MAX_ENTRIES, 0):
            await cache.respond(what, read)

    reads = CountingReader()
    with closing(ResponseCache(database)) as cache:
        asyncio.run(request(cache, reads))
    assert reads.times == MAX_ENTRIES + 2  # the last entry replaced the first


def test_expired_values_are_dropped(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.api.response_cache.MAX_AGE_S", -1.0)

    async def request(cache: ResponseCache) -> list[weakref.ref[Response]]:
        kept = [weakref.ref(await cache.respond(key, CountingReader())) for key in range(MAX_ENTRIES // 2)]
        await cache.respond("next", CountingReader())
        gc.collect()
        return kept

    with closing(ResponseCache(database)) as cache:
        assert [kept() for kept in asyncio.run(request(cache))] == [None] * (MAX_ENTRIES // 2)
