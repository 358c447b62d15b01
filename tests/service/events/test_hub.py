"""Events reach subscribers from any thread, in order and with bounded memory. Nothing waits for a slow subscriber."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from typing import Any
from unittest.mock import patch

from service.events.hub import MAX_BACKLOG, MAX_INBOX, EventHub, Mark, Subscriber


def in_loop(test: Callable[[], Coroutine[Any, Any, None]]) -> Callable[[], None]:
    def run() -> None:
        asyncio.run(asyncio.wait_for(test(), 60))

    run.__name__ = test.__name__
    return run


async def received(subscriber: Subscriber[Any]) -> list[Any]:
    """Return the items that have come so far."""
    await asyncio.sleep(0)  # what was published is delivered by then
    found = []
    while (item := await subscriber.next(0.05)) is not None:
        found.append(item)
    return found


def test_a_hub_without_subscribers_keeps_nothing_and_needs_no_loop() -> None:
    hub = EventHub[int]()
    hub.publish("s1", 1)
    hub.close()

    async def subscribe_once() -> None:
        with hub.subscribe("s1") as subscriber:
            assert await subscriber.next(1) is Mark.CLOSED

    asyncio.run(subscribe_once())


@in_loop
async def test_each_subscriber_gets_its_topic_in_order() -> None:
    hub = EventHub[int]()
    hub.publish("s1", 0)
    with hub.subscribe("s1") as one, hub.subscribe("s2") as two, hub.subscribe(None) as everything:
        assert hub.subscribers == 3
        for number in range(1, 5):
            hub.publish("s1" if number % 2 else "s2", number)
        hub.publish(None, 5)
        assert await received(one) == [1, 3]
        assert await received(two) == [2, 4]
        assert await received(everything) == [1, 2, 3, 4, 5]
    assert hub.subscribers == 0


@in_loop
async def test_many_threads_publish_to_many_subscribers() -> None:
    hub, followers = EventHub[tuple[int, int]](), []
    each, threads = MAX_BACKLOG // 8, 8

    def publish(thread: int) -> None:
        for number in range(each):
            hub.publish("s", (thread, number))

    async def subscribe_once() -> list[Any]:
        with hub.subscribe("s") as subscriber:
            ready.release()
            return [await subscriber.next() for _ in range(each * threads)]

    ready = asyncio.Semaphore(0)
    followers = [asyncio.create_task(subscribe_once()) for _ in range(50)]
    for _ in followers:
        await ready.acquire()
    publishers = [threading.Thread(target=publish, args=(n,)) for n in range(threads)]
    for thread in publishers:
        thread.start()
    received_items = [await subscriber for subscriber in followers]
    for thread in publishers:
        thread.join()
    assert all(items == received_items[0] for items in received_items)
    for thread in range(threads):
        assert [number for of, number in received_items[0] if of == thread] == list(range(each))


@in_loop
async def test_only_a_slow_subscriber_loses_its_backlog_and_gets_a_mark() -> None:
    hub = EventHub[int]()
    with hub.subscribe("s") as slow, hub.subscribe("s") as quick:
        for number in range(MAX_BACKLOG):
            hub.publish("s", number)
        assert await received(quick) == list(range(MAX_BACKLOG))
        for number in (1000, 1001, 1002):
            hub.publish("s", number)
        assert await received(quick) == [1000, 1001, 1002]
        # the event that exceeded the backlog is lost with the others; the present state contains it
        assert await received(slow) == [Mark.MISSED, 1001, 1002]
        hub.publish("s", 1003)
        assert await received(slow) == [1003]


@in_loop
async def test_a_blocked_loop_takes_bounded_memory() -> None:
    hub = EventHub[int]()
    with hub.subscribe("s") as subscriber:
        for number in range(3 * MAX_INBOX):  # without a turn of the loop
            hub.publish("s", number)
        assert len(hub._inbox) <= MAX_INBOX
        found = await received(subscriber)
    assert Mark.MISSED in found
    assert found[-1] == 3 * MAX_INBOX - 1
    assert len(found) <= MAX_BACKLOG + 1


@in_loop
async def test_events_published_together_take_one_wake_up() -> None:
    hub, loop = EventHub[int](), asyncio.get_running_loop()
    counted = patch.object(loop, "call_soon_threadsafe", wraps=loop.call_soon_threadsafe)
    with counted as wake_up, hub.subscribe("s") as one, hub.subscribe("s") as two:
        for number in range(10):
            hub.publish("s", number)
        assert len(await received(one)) == len(await received(two)) == 10
    assert wake_up.call_count == 1


@in_loop
async def test_close_delivers_all_events_and_then_a_mark() -> None:
    hub = EventHub[int]()
    with hub.subscribe("s") as subscriber:
        hub.publish("s", 1)
        hub.close()
        assert hub.closed
        hub.publish("s", 2)
        assert await received(subscriber) == [1, Mark.CLOSED]
    with hub.subscribe("s") as late:
        assert await received(late) == [Mark.CLOSED]


@in_loop
async def test_next_returns_none_after_its_timeout() -> None:
    with EventHub[int]().subscribe("s") as subscriber:
        assert await subscriber.next(0.01) is None


def test_publishing_works_after_the_loop_has_ended() -> None:
    hub = EventHub[int]()
    loop = asyncio.new_event_loop()

    async def subscribe_once() -> None:
        hub.subscribe("s").__enter__()  # never closed

    loop.run_until_complete(subscribe_once())
    loop.close()
    hub.publish("s", 1)
    hub.publish("s", 2)

    async def again() -> None:
        with hub.subscribe("s") as subscriber:
            hub.publish("s", 3)
            assert await received(subscriber) == [3]

    asyncio.run(again())
