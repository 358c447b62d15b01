"""Signals while a command moves the arm, whichever thread the system hands them to."""

import signal
import threading
import time
from collections.abc import Callable

import pytest

from service.signals import with_signals

LONG_S = 20.0
"""A signal that is not met by then is not met at all."""


def test_without_a_signal_the_result_is_handed_out() -> None:
    assert with_signals(lambda: 42, lambda: None) == 42


def test_an_error_of_the_work_comes_through() -> None:
    with pytest.raises(ZeroDivisionError):
        with_signals(lambda: 1 // 0, lambda: None)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("thread", [threading.main_thread, threading.current_thread])
def test_a_signal_is_met_whichever_thread_it_is_handed_to(
    number: signal.Signals, thread: Callable[[], threading.Thread]
) -> None:
    met = threading.Event()

    def work() -> bool:
        ident = thread().ident
        assert ident is not None
        time.sleep(0.2)  # until the main thread waits
        signal.pthread_kill(ident, number)
        return met.wait(LONG_S)

    assert with_signals(work, met.set)


def test_what_is_done_at_a_signal_is_done_once_and_in_the_main_thread() -> None:
    done: list[threading.Thread] = []
    ended = threading.Event()

    def work() -> bool:
        for _ in range(3):
            signal.raise_signal(signal.SIGTERM)
        return ended.wait(LONG_S)

    def at_signal() -> None:
        done.append(threading.current_thread())
        ended.set()

    assert with_signals(work, at_signal)
    assert done == [threading.main_thread()]


def test_signals_that_the_parent_blocked_are_met_all_the_same() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    met = threading.Event()

    def work() -> bool:
        main = threading.main_thread().ident
        assert main is not None
        signal.pthread_kill(main, signal.SIGTERM)
        return met.wait(LONG_S)

    try:
        assert with_signals(work, met.set)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_what_failed_at_one_signal_is_tried_again_at_the_next(caplog: pytest.LogCaptureFixture) -> None:
    tried: list[bool] = []
    met = threading.Event()

    def at_signal() -> None:
        tried.append(True)
        if len(tried) == 1:
            raise OSError("no way to the arm")
        met.set()

    def work() -> bool:
        signal.raise_signal(signal.SIGTERM)
        while not tried:
            time.sleep(0.01)
        signal.raise_signal(signal.SIGTERM)
        return met.wait(LONG_S)

    assert with_signals(work, at_signal)
    assert len(tried) == 2
    assert "no way to the arm" in caplog.text
