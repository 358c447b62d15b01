"""What is asked for most has threads and a memory of its own, and says what FastAPI would have said."""

import asyncio
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import httpx
import pytest
from starlette.responses import Response

from service.api.response_cache import REMEMBERED, SMALL_BYTES, Reading
from service.api.schemas.scans import ScanList
from service.storage.database import Database
from service.storage.store import Store
from tests.service.conftest import PATIENCE_S, wait_until

SHARED_THREADS = 40
"""Starlette's, of all plain routes together."""


def test_answers_come_while_all_other_threads_are_held(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_what_goes_wrong_in_them_is_told_as_elsewhere(client: httpx.Client) -> None:
    answer = client.get("/api/scans/none")
    assert (answer.status_code, answer.json()["type"]) == (404, "urn:pointchain:scan-not-found")
    assert client.get("/api/scans/none/model").status_code == 404
    assert client.get("/api/scans").headers["content-type"] == "application/json"


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    with closing(Database(tmp_path / "store.db")) as database:
        yield database


class Reads:
    """Counts how often something is read; `hold` keeps the readers waiting."""

    def __init__(self) -> None:
        self.times = 0
        self.hold: threading.Event | None = None

    def __call__(self) -> Response:
        self.times += 1
        if self.hold is not None:
            assert self.hold.wait(PATIENCE_S)
        return Response(str(self.times))


def test_what_has_not_changed_is_read_once(database: Database) -> None:
    async def ask(reading: Reading, read: Reads) -> list[bytes | memoryview]:
        seen = [(await reading.answer("x", read)).body for _ in range(3)]
        with database.transaction():
            pass
        return [*seen, (await reading.answer("x", read)).body]

    with closing(Reading(database)) as reading:
        assert asyncio.run(ask(reading, Reads())) == [b"1", b"1", b"1", b"2"]


def test_what_others_may_have_changed_is_looked_at_again(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("service.api.response_cache.FRESH_S", -1.0)

    async def ask(reading: Reading, read: Reads) -> list[bytes | memoryview]:
        return [(await reading.answer("x", read)).body for _ in range(2)]

    with closing(Reading(database)) as reading:
        assert asyncio.run(ask(reading, Reads())) == [b"1", b"2"]


def test_many_who_ask_at_once_wait_for_one_who_reads_also_when_the_first_leaves(database: Database) -> None:
    async def ask(reading: Reading, read: Reads) -> list[bytes | memoryview]:
        read.hold = threading.Event()
        first, *others = [asyncio.ensure_future(reading.answer("x", read)) for _ in range(5)]
        await asyncio.sleep(0.02)
        first.cancel()
        await asyncio.sleep(0)
        read.hold.set()
        return [answer.body for answer in await asyncio.gather(*others)]

    with closing(Reading(database)) as reading:
        assert asyncio.run(ask(reading, Reads())) == [b"1"] * 4


def test_neither_failures_nor_large_answers_are_remembered(database: Database) -> None:
    large = Reads()

    def fail() -> Response:
        raise ValueError("for now")

    def read_large() -> Response:
        return Response(bytes(large().body) * (SMALL_BYTES + 1))

    async def ask(reading: Reading) -> bytes | memoryview:
        with pytest.raises(ValueError, match="for now"):
            await reading.answer("x", fail)
        for _ in range(2):
            await reading.answer("y", read_large)
        return (await reading.answer("x", Reads())).body

    with closing(Reading(database)) as reading:
        assert asyncio.run(ask(reading)) == b"1"
    assert large.times == 2


def test_no_more_than_so_many_are_remembered(database: Database) -> None:
    async def ask(reading: Reading, read: Reads) -> None:
        for what in (*range(REMEMBERED + 1), REMEMBERED, 0):
            await reading.answer(what, read)

    reads = Reads()
    with closing(Reading(database)) as reading:
        asyncio.run(ask(reading, reads))
    assert reads.times == REMEMBERED + 2  # the first was forgotten for the last
