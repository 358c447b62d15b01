"""News from any thread to whoever follows: in order, within bounds, and nobody waits for a slow one."""

import asyncio
import threading
from collections.abc import Callable, Coroutine
from typing import Any
from unittest.mock import patch

from service.events.hub import BACKLOG, INBOX, EventHub, Follower, Mark


def in_loop(test: Callable[[], Coroutine[Any, Any, None]]) -> Callable[[], None]:
    def run() -> None:
        asyncio.run(asyncio.wait_for(test(), 60))

    run.__name__ = test.__name__
    return run


async def waiting(follower: Follower[Any]) -> list[Any]:
    """All that has come so far."""
    await asyncio.sleep(0)  # what was published is delivered by then
    found = []
    while (item := await follower.next(0.05)) is not None:
        found.append(item)
    return found


def test_without_anybody_it_keeps_nothing_and_needs_no_loop() -> None:
    hub = EventHub[int]()
    hub.publish("s1", 1)
    hub.close()

    async def follow() -> None:
        with hub.following("s1") as news:
            assert await news.next(1) is Mark.CLOSED

    asyncio.run(follow())


@in_loop
async def test_each_gets_what_he_follows_in_order() -> None:
    hub = EventHub[int]()
    hub.publish("s1", 0)
    with hub.following("s1") as one, hub.following("s2") as two, hub.following(None) as everything:
        assert hub.followers == 3
        for number in range(1, 5):
            hub.publish("s1" if number % 2 else "s2", number)
        hub.publish(None, 5)
        assert await waiting(one) == [1, 3]
        assert await waiting(two) == [2, 4]
        assert await waiting(everything) == [1, 2, 3, 4, 5]
    assert hub.followers == 0


@in_loop
async def test_many_threads_publish_to_many() -> None:
    hub, followers = EventHub[tuple[int, int]](), []
    each, threads = BACKLOG // 8, 8

    def publish(thread: int) -> None:
        for number in range(each):
            hub.publish("s", (thread, number))

    async def follow() -> list[Any]:
        with hub.following("s") as news:
            ready.release()
            return [await news.next() for _ in range(each * threads)]

    ready = asyncio.Semaphore(0)
    followers = [asyncio.create_task(follow()) for _ in range(50)]
    for _ in followers:
        await ready.acquire()
    publishers = [threading.Thread(target=publish, args=(n,)) for n in range(threads)]
    for thread in publishers:
        thread.start()
    told = [await follower for follower in followers]
    for thread in publishers:
        thread.join()
    assert all(items == told[0] for items in told)
    for thread in range(threads):
        assert [number for of, number in told[0] if of == thread] == list(range(each))


@in_loop
async def test_who_does_not_keep_up_loses_his_backlog_alone_and_is_told() -> None:
    hub = EventHub[int]()
    with hub.following("s") as slow, hub.following("s") as quick:
        for number in range(BACKLOG):
            hub.publish("s", number)
        assert await waiting(quick) == list(range(BACKLOG))
        for number in (1000, 1001, 1002):
            hub.publish("s", number)
        assert await waiting(quick) == [1000, 1001, 1002]
        # The one that was too many is gone with the others: whoever looks at the present state finds it there.
        assert await waiting(slow) == [Mark.MISSED, 1001, 1002]
        hub.publish("s", 1003)
        assert await waiting(slow) == [1003]


@in_loop
async def test_a_loop_that_hangs_costs_bounded_memory() -> None:
    hub = EventHub[int]()
    with hub.following("s") as news:
        for number in range(3 * INBOX):  # no turn of the loop in between
            hub.publish("s", number)
        assert len(hub._inbox) <= INBOX
        found = await waiting(news)
    assert Mark.MISSED in found
    assert found[-1] == 3 * INBOX - 1
    assert len(found) <= BACKLOG + 1


@in_loop
async def test_one_wake_up_for_all_that_is_published_meanwhile() -> None:
    hub, loop = EventHub[int](), asyncio.get_running_loop()
    counted = patch.object(loop, "call_soon_threadsafe", wraps=loop.call_soon_threadsafe)
    with counted as wake_up, hub.following("s") as one, hub.following("s") as two:
        for number in range(10):
            hub.publish("s", number)
        assert len(await waiting(one)) == len(await waiting(two)) == 10
    assert wake_up.call_count == 1


@in_loop
async def test_at_the_end_all_is_told_and_then_that_it_is_the_end() -> None:
    hub = EventHub[int]()
    with hub.following("s") as news:
        hub.publish("s", 1)
        hub.close()
        assert hub.closed
        hub.publish("s", 2)
        assert await waiting(news) == [1, Mark.CLOSED]
    with hub.following("s") as late:
        assert await waiting(late) == [Mark.CLOSED]


@in_loop
async def test_waiting_ends_in_time_without_news() -> None:
    with EventHub[int]().following("s") as news:
        assert await news.next(0.01) is None


def test_a_loop_that_has_ended_is_no_trouble_to_who_publishes() -> None:
    hub = EventHub[int]()
    loop = asyncio.new_event_loop()

    async def follow() -> None:
        hub.following("s").__enter__()  # and nobody leaves it

    loop.run_until_complete(follow())
    loop.close()
    hub.publish("s", 1)
    hub.publish("s", 2)

    async def again() -> None:
        with hub.following("s") as news:
            hub.publish("s", 3)
            assert await waiting(news) == [3]

    asyncio.run(again())
