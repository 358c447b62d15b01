"""An event loop that hangs is noticed, once, with what it is at; a slow machine is not taken for one."""

import asyncio
import logging
import threading
import time

import pytest

from service.server.event_loop_watchdog import HUNG_TICKS, TICK_S, LoopWatch


def test_a_loop_that_hangs_is_noticed_once_each_time(caplog: pytest.LogCaptureFixture) -> None:
    hung: list[float] = []

    async def run() -> None:
        watch = LoopWatch(asyncio.get_running_loop(), lambda: hung.append(time.monotonic()))
        try:
            for number in range(1, 3):
                begin = time.monotonic()
                hold_the_loop(lambda number=number: len(hung) == number)
                assert hung[-1] - begin >= HUNG_TICKS * TICK_S - 2 * TICK_S  # not at once
                assert not watch.turning
                while not watch.turning:
                    await asyncio.sleep(0.01)
        finally:
            watch.close()

    with caplog.at_level(logging.WARNING, "service.server.event_loop_watchdog"):
        asyncio.run(run())
    assert len(hung) == 2
    said = [record.getMessage() for record in caplog.records]
    assert [text.split(",")[0] for text in said] == ["the event loop hangs", "the event loop turns again"] * 2
    assert "hold_the_loop" in said[0]


def hold_the_loop(until: object) -> None:
    assert callable(until)
    deadline = time.monotonic() + 60
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.3)  # some ticks more: it is told once


def test_a_loop_that_turns_now_and_then_does_not_hang() -> None:
    hung = threading.Event()

    async def run() -> None:
        watch = LoopWatch(asyncio.get_running_loop(), hung.set)
        for _ in range(6):
            time.sleep(HUNG_TICKS * TICK_S / 3)
            await asyncio.sleep(0.01)
        watch.close()

    asyncio.run(run())
    assert not hung.is_set()


def test_a_watch_outlives_its_loop() -> None:
    async def run() -> LoopWatch:
        return LoopWatch(asyncio.get_running_loop(), lambda: None)

    asyncio.run(run()).close()
