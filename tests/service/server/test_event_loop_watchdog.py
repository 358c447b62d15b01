"""The watchdog reports each hang of the event loop once, with its stack. A slow loop is not a hang."""

import asyncio
import logging
import threading
import time

import pytest

from service.server.event_loop_watchdog import HUNG_TICKS, TICK_S, EventLoopWatchdog


def test_each_hang_of_the_loop_is_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    hung: list[float] = []

    async def run() -> None:
        watchdog = EventLoopWatchdog(asyncio.get_running_loop(), lambda: hung.append(time.monotonic()))
        try:
            for number in range(1, 3):
                begin = time.monotonic()
                block_the_loop(lambda number=number: len(hung) == number)
                assert hung[-1] - begin >= HUNG_TICKS * TICK_S - 2 * TICK_S  # not too early
                assert not watchdog.is_responsive
                while not watchdog.is_responsive:
                    await asyncio.sleep(0.01)
        finally:
            watchdog.close()

    with caplog.at_level(logging.WARNING, "service.server.event_loop_watchdog"):
        asyncio.run(run())
    assert len(hung) == 2
    messages = [record.getMessage() for record in caplog.records]
    assert [text.split(",")[0] for text in messages] == ["the event loop hangs", "the event loop runs again"] * 2
    assert "block_the_loop" in messages[0]


def block_the_loop(until: object) -> None:
    assert callable(until)
    deadline = time.monotonic() + 60
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(0.3)  # some further ticks, which must not report it again


def test_a_slow_loop_does_not_hang() -> None:
    hung = threading.Event()

    async def run() -> None:
        watchdog = EventLoopWatchdog(asyncio.get_running_loop(), hung.set)
        for _ in range(6):
            time.sleep(HUNG_TICKS * TICK_S / 3)
            await asyncio.sleep(0.01)
        watchdog.close()

    asyncio.run(run())
    assert not hung.is_set()


def test_a_watchdog_outlives_its_loop() -> None:
    async def run() -> EventLoopWatchdog:
        return EventLoopWatchdog(asyncio.get_running_loop(), lambda: None)

    asyncio.run(run()).close()
