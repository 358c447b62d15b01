"""One virtual controller for all tests of this folder in a process. `virtual_arm.fresh` resets it."""

from collections.abc import Iterator

import pytest

from cell.simulation.ur_controller.launcher import RunningController, start_controller
from tests.cell.loopback import free_host


@pytest.fixture(scope="session")
def controller() -> Iterator[RunningController]:
    with start_controller(host=free_host()) as controller:
        yield controller
