"""One virtual controller for all tests of a module. `virtual_arm.fresh` resets it.

One for the whole session would go on with its cycle until the last test, which takes more time than a start per module.
"""

from collections.abc import Iterator

import pytest

from cell.simulation.ur_controller.launcher import RunningController, start_controller
from tests.cell.loopback import free_host


@pytest.fixture(scope="module")
def controller() -> Iterator[RunningController]:
    with start_controller(host=free_host()) as controller:
        yield controller
