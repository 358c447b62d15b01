"""Options of the tests on pytest's command line, and signals of the processes that tests start."""

import os
import signal

import pytest

NICE_INCREMENT = 10
"""Increment of the niceness of a test process that runs no tests of the group `cell`."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of the tests of a controller."""
    group = parser.getgroup("pointchain")
    group.addoption(
        "--host",
        help="with `-m ursim`: the controller to drive in place of the virtual one, as URSim's. ITS ARM MOVES",
    )
    group.addoption("--model", default="ur5e", choices=("ur3e", "ur5e", "ur10e"), help="which arm it has (%(default)s)")


def pytest_configure() -> None:
    """Let Ctrl-C reach the processes that tests start: what a shell starts in the background ignores it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_xdist_auto_num_workers() -> int:
    """Return the number of test processes for `-n auto`: one more than cores, because the group `cell` mostly waits."""
    return len(os.sched_getaffinity(0)) + 1 if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1) + 1


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Give way to the tests of the group `cell`, which depend on time. One other process runs all of them."""
    if "PYTEST_XDIST_WORKER" in os.environ and item.get_closest_marker("xdist_group") is None and os.nice(0) == 0:
        os.nice(NICE_INCREMENT)
