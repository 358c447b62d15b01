"""One virtual controller for all tests of a module, reset before each test."""

from collections.abc import Iterator

import pytest

from cell.simulation.ur_controller.launcher import RunningController, start_controller
from tests.cell.simulation.ur_controller.cell_log import FAST, HOME_Q_RAD


@pytest.fixture(scope="module")
def running_controller() -> Iterator[RunningController]:
    with start_controller() as controller:
        yield controller


@pytest.fixture
def controller(running_controller: RunningController) -> RunningController:
    running_controller.admin.reset(HOME_Q_RAD)
    running_controller.admin.table(None)
    return running_controller


@pytest.fixture(scope="module")
def running_fast_controller() -> Iterator[RunningController]:
    with start_controller("ur3e", time_factor=FAST, software="5.11.0") as controller:
        yield controller


@pytest.fixture
def fast_controller(running_fast_controller: RunningController) -> RunningController:
    """Return a controller of an older and smaller arm that moves faster than real time."""
    running_fast_controller.admin.reset(HOME_Q_RAD)
    return running_fast_controller
