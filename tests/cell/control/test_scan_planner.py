"""A plan uses the groundwork that is laid in advance."""

import subprocess
import sys
from collections.abc import Iterator

import pytest

from cell.config.cell_config import CellSettings
from cell.control.scan_planner import ScanPlanner
from cell.errors import ViewpointsError
from cell.planning import groundwork
from cell.planning.viewpoints import plan_viewpoints
from cell.simulation.devices.world import simulated_world

SETTINGS = CellSettings()
T_FLANGE_CAMERA = simulated_world(SETTINGS).nominal_T_flange_camera


@pytest.fixture(autouse=True)
def nothing_kept() -> Iterator[None]:
    groundwork._kept_groundwork.cache_clear()
    yield
    groundwork._kept_groundwork.cache_clear()


@pytest.mark.parametrize("views", [3, None])
def test_a_plan_waits_for_the_groundwork_that_is_being_laid(views: int | None) -> None:
    planner = ScanPlanner(SETTINGS)
    planner.prepare(views, T_FLANGE_CAMERA)
    plan = planner.plan(views, T_FLANGE_CAMERA, None).to_json()
    assert groundwork._kept_groundwork.cache_info().misses == 1
    expected = plan_viewpoints(SETTINGS.for_views(views), T_FLANGE_CAMERA, None).to_json()
    assert plan | {"planning_s": 0.0} == expected | {"planning_s": 0.0}


def test_an_error_of_the_groundwork_is_raised_by_the_plan() -> None:
    arm = SETTINGS.arm.model_copy(update={"home_q_rad": (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)})  # below the table
    planner = ScanPlanner(SETTINGS.model_copy(update={"arm": arm}))
    planner.prepare(None, T_FLANGE_CAMERA)
    for _ in range(2):
        with pytest.raises(ViewpointsError, match=r"home_q_rad in \[arm\] is not free"):
            planner.plan(None, T_FLANGE_CAMERA, None)


END_WHILE_LAYING = """
import atexit
import numpy as np
from cell.config.cell_config import CellSettings
from cell.control.scan_planner import ScanPlanner
from cell.planning import groundwork
atexit.register(lambda: print(groundwork._kept_groundwork.cache_info().currsize))
ScanPlanner(CellSettings()).prepare(None, np.eye(4))
"""


def test_a_process_ends_after_the_groundwork() -> None:
    # NumPy aborts a process that ends while it computes in another thread
    ended = subprocess.run([sys.executable, "-c", END_WHILE_LAYING], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (0, "1\n"), ended.stderr
