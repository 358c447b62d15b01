"""Who wants to know of the cell's status is told of every change, and nobody waits for him."""

import threading
from typing import Any

import pytest

from cell.control.status import CellStatus, SharedStatus


def test_each_change_is_told_in_order_whichever_thread_makes_it() -> None:
    status, told = SharedStatus(), list[CellStatus]()
    status.subscribe(told.append)

    def change(thread: int) -> None:
        for number in range(500):
            status.change(reason=f"{thread} {number}")

    threads = [threading.Thread(target=change, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(told) == 2000
    assert told[-1] is status.now
    for thread in range(4):
        own = [one.reason for one in told if (one.reason or "").startswith(f"{thread} ")]
        assert own == [f"{thread} {number}" for number in range(500)]


def test_what_changes_nothing_is_not_told() -> None:
    status, told = SharedStatus(), list[CellStatus]()
    status.subscribe(told.append)
    status.leave_ready("stopped", "by request")  # it was not ready
    assert told == []
    status.set_outcome(None)
    status.leave_ready("stopped", "by request")
    assert [one.state for one in told] == ["ready", "not_ready"]


def test_who_changes_it_does_not_wait_for_one_who_is_being_told() -> None:
    status, told, entered, let_go = SharedStatus(), list[str | None](), threading.Event(), threading.Event()

    def slow(now: CellStatus) -> None:
        entered.set()
        assert let_go.wait(60)
        told.append(now.slug)

    status.subscribe(slow)
    first = threading.Thread(target=status.change, kwargs={"slug": "first"})
    first.start()
    assert entered.wait(60)
    status.change(slug="second")  # returns, though nobody was told of it yet
    assert (status.now.slug, told) == ("second", [])
    let_go.set()
    first.join()
    assert told == ["first", "second"]


def test_a_listener_that_fails_or_changes_the_status_itself(caplog: pytest.LogCaptureFixture) -> None:
    status, told = SharedStatus(), list[Any]()

    def fails(_: CellStatus) -> None:
        raise RuntimeError("of no use")

    def reacts(now: CellStatus) -> None:
        if now.state == "ready" and now.slug is None:
            status.change(slug="seen")

    for listener in (fails, reacts, lambda now: told.append((now.state, now.slug))):
        status.subscribe(listener)
    status.set_outcome(None)
    assert told == [("ready", None), ("ready", "seen")]
    assert caplog.messages == ["a listener to the cell's status failed"] * 2
