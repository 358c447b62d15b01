"""Fixtures for the tests of the examples: those of the service, and cells that all of them share."""

from collections.abc import Iterator

import pytest

from tests.service.conftest import Serve, fork_server, recording_file, serve
from tests.service.live_cell import LiveCell, live_cell, release_used

__all__ = ["fork_server", "recording_file", "serve"]


@pytest.fixture(autouse=True)
def _arms_are_released(request: pytest.FixtureRequest) -> Iterator[None]:
    """The cells run side by side until the last test of the examples."""
    yield
    release_used(request)


@pytest.fixture(scope="package")
def knot(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell with a string on the table."""
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


@pytest.fixture(scope="package")
def short_gripper(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A cell with a string on the table. The camera meets the table at each grasp, because the gripper is short."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), gripper={"length_m": 0.07}) as shared:
        yield shared
