"""Fixtures with a data folder that the tests damage."""

import dataclasses
import shutil
from pathlib import Path

import pytest

from tests.service.stored_data import Data, make_data


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, recording_file: Path) -> Data:
    """Return a complete data folder that is made once. Each test gets a copy."""
    return make_data(tmp_path_factory.mktemp("whole"), recording_file)


@pytest.fixture
def data(whole: Data, tmp_path: Path) -> Data:
    """Return a copy of the data folder that the test may damage."""
    shutil.copytree(whole.root, tmp_path / "data")
    return dataclasses.replace(whole, root=tmp_path / "data")
