"""Listeners receive every change of the status in order, and no change waits for a listener."""

import threading
from typing import Any

import pytest

from cell.control.status import CellStatus, SharedStatus


def test_changes_of_several_threads_are_delivered_in_order() -> None:
    status, received = SharedStatus(), list[CellStatus]()
    status.subscribe(received.append)

    def change(thread: int) -> None:
        for number in range(500):
            status.change(reason=f"{thread} {number}")

    threads = [threading.Thread(target=change, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(received) == 2000
    assert received[-1] is status.now
    for thread in range(4):
        own = [one.reason for one in received if (one.reason or "").startswith(f"{thread} ")]
        assert own == [f"{thread} {number}" for number in range(500)]


def test_an_unchanged_status_is_not_delivered() -> None:
    status, received = SharedStatus(), list[CellStatus]()
    status.subscribe(received.append)
    status.leave_ready("stopped", "by request")  # the cell was not ready
    assert received == []
    status.set_outcome(None)
    status.leave_ready("stopped", "by request")
    assert [one.state for one in received] == ["ready", "not_ready"]


def test_a_change_does_not_wait_for_a_slow_listener() -> None:
    status, received, entered, release = SharedStatus(), list[str | None](), threading.Event(), threading.Event()

    def slow(now: CellStatus) -> None:
        entered.set()
        assert release.wait(60)
        received.append(now.slug)

    status.subscribe(slow)
    first = threading.Thread(target=status.change, kwargs={"slug": "first"})
    first.start()
    assert entered.wait(60)
    status.change(slug="second")  # returns before the change is delivered
    assert (status.now.slug, received) == ("second", [])
    release.set()
    first.join()
    assert received == ["first", "second"]


def test_a_listener_may_fail_or_change_the_status(caplog: pytest.LogCaptureFixture) -> None:
    status, received = SharedStatus(), list[Any]()

    def fails(_: CellStatus) -> None:
        raise RuntimeError("of no use")

    def reacts(now: CellStatus) -> None:
        if now.state == "ready" and now.slug is None:
            status.change(slug="seen")

    for listener in (fails, reacts, lambda now: received.append((now.state, now.slug))):
        status.subscribe(listener)
    status.set_outcome(None)
    assert received == [("ready", None), ("ready", "seen")]
    assert caplog.messages == ["a listener to the cell's status failed"] * 2
