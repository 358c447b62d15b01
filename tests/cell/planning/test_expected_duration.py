"""How long a scan is expected to take. Live scans in tests/service/jobs are compared with it."""

import pytest

from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.planning.expected_duration import RECOGNITION_S, VIEW_OVERHEAD_S, expected_duration
from cell.planning.viewpoints import plan_viewpoints
from tests.cell.planning.test_viewpoints import T_FLANGE_CAMERA

EXACT = SimulatedCamera(settle_s=0.1, exposures=5, fps=10.0)
DWELL_S = 0.6 + VIEW_OVERHEAD_S


def test_all_views_are_expected_of_a_number() -> None:
    settings = CellSettings(camera=EXACT)
    plan = plan_viewpoints(settings, T_FLANGE_CAMERA, None)
    expected = expected_duration(plan, settings)
    assert expected.to_home_s == pytest.approx(plan.duration_s + 8 * DWELL_S)
    assert expected.to_model_s == pytest.approx(
        plan.duration_s - plan.legs[-1].duration_s + 8 * DWELL_S + RECOGNITION_S
    )


@pytest.mark.parametrize("views", [4, 6])
def test_a_scan_that_ends_early_returns_home_after_the_decision(views: int) -> None:
    settings = CellSettings(camera=EXACT).for_views("auto")
    plan = plan_viewpoints(settings, T_FLANGE_CAMERA, None)
    expected = expected_duration(plan, settings, views)
    motion_s = sum(leg.duration_s for leg in plan.legs[:views])
    assert expected.to_model_s == pytest.approx(motion_s + views * DWELL_S + RECOGNITION_S)
    assert expected.to_home_s == pytest.approx(expected.to_model_s + plan.legs[views - 1].home_duration_s)
    assert expected_duration(plan, settings, 8) == expected_duration(plan, settings)


def test_a_simulated_arm_may_be_faster() -> None:
    settings = CellSettings(arm=SimulatedArm(time_factor=4.0), camera=EXACT)
    plan = plan_viewpoints(settings, T_FLANGE_CAMERA, None)
    assert expected_duration(plan, settings).to_home_s == pytest.approx(plan.duration_s / 4 + 8 * DWELL_S)
