"""Options of the tests on pytest's command line, signals of the processes that tests start, garbage collection."""

import gc
import signal
from collections.abc import Iterator

import pytest


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


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Exclude the collected tests and their modules from garbage collection: they stay until the end.

    Garbage collection would visit all of them each time, and none can be freed.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
