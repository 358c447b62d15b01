"""Signals while a command moves the arm, whichever thread the system delivers them to."""

import signal
import threading
import time
from collections.abc import Callable

import pytest

from service.signals import run_with_signal_handler

TIMEOUT_S = 20.0
"""A signal that is not handled within this time counts as lost."""


def test_without_a_signal_the_result_is_returned() -> None:
    assert run_with_signal_handler(lambda: 42, lambda: None) == 42


def test_an_error_of_the_work_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        run_with_signal_handler(lambda: 1 // 0, lambda: None)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("thread", [threading.main_thread, threading.current_thread])
def test_a_signal_is_handled_whichever_thread_receives_it(
    number: signal.Signals, thread: Callable[[], threading.Thread]
) -> None:
    handled = threading.Event()

    def work() -> bool:
        ident = thread().ident
        assert ident is not None
        time.sleep(0.2)  # until the main thread waits
        signal.pthread_kill(ident, number)
        return handled.wait(TIMEOUT_S)

    assert run_with_signal_handler(work, handled.set)


def test_the_handler_runs_once_and_in_the_main_thread() -> None:
    threads: list[threading.Thread] = []
    handled = threading.Event()

    def work() -> bool:
        for _ in range(3):
            signal.raise_signal(signal.SIGTERM)
        return handled.wait(TIMEOUT_S)

    def on_signal() -> None:
        threads.append(threading.current_thread())
        handled.set()

    assert run_with_signal_handler(work, on_signal)
    assert threads == [threading.main_thread()]


def test_signals_that_the_parent_blocked_are_handled() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
    handled = threading.Event()

    def work() -> bool:
        main = threading.main_thread().ident
        assert main is not None
        signal.pthread_kill(main, signal.SIGTERM)
        return handled.wait(TIMEOUT_S)

    try:
        assert run_with_signal_handler(work, handled.set)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_a_handler_that_failed_runs_again_at_the_next_signal(caplog: pytest.LogCaptureFixture) -> None:
    calls: list[bool] = []
    handled = threading.Event()

    def on_signal() -> None:
        calls.append(True)
        if len(calls) == 1:
            raise OSError("no way to the arm")
        handled.set()

    def work() -> bool:
        signal.raise_signal(signal.SIGTERM)
        while not calls:
            time.sleep(0.01)
        signal.raise_signal(signal.SIGTERM)
        return handled.wait(TIMEOUT_S)

    assert run_with_signal_handler(work, on_signal)
    assert len(calls) == 2
    assert "no way to the arm" in caplog.text
