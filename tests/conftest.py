"""Options of the tests on pytest's command line, signals of their processes, garbage collection, distribution.

Also the profile of Hypothesis: no test fails because the machine is busy.
"""

import gc
import signal
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("busy-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy-machine")


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


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let one worker run all tests of a module that share a fixture, so that the fixture is made only once."""
    for item in items:
        if isinstance(item, pytest.Function) and item.get_closest_marker("xdist_group") is None:
            fixtures = item._fixtureinfo.name2fixturedefs.values()
            if any(fixture.scope == "module" for overridden in fixtures for fixture in overridden):
                item.add_marker(pytest.mark.xdist_group(item.nodeid.partition("::")[0]))
