"""The self-test of the grasps: the share that is reached, reasons and advice."""

from dataclasses import replace

import pytest

from cell.config.cell_config import CellSettings, MountingSettings, WorkspaceSettings
from cell.config.gripper_config import GripperSettings
from cell.self_test.check_result import CheckResult
from cell.self_test.grasp_check import ADVICE, grasps, upright_grasps
from tests.cell.self_test.cells_to_check import EXACT, exact_frames, grounds_for

pytestmark = pytest.mark.slow


def checked(settings: CellSettings) -> CheckResult:
    context = grounds_for(settings)
    return grasps(replace(context, hand_eye=exact_frames().world.nominal_hand_eye))


def with_gripper(**values: object) -> CellSettings:
    return EXACT.model_copy(update={"gripper": GripperSettings.model_validate(values)})


def test_the_grasps_cover_the_workspace() -> None:
    T = upright_grasps(EXACT.model_copy(update={"mounting": MountingSettings(table_z_m=-0.1)}), 0.004)
    assert T.shape == (100, 4, 4)
    (x0, x1), (y0, y1), _ = EXACT.workspace_m
    # in the middle of 5 x 5 tiles
    assert T[:, :3, 3].min(axis=0) == pytest.approx((x0 + (x1 - x0) / 10, y0 + (y1 - y0) / 10, -0.096))
    assert T[:, :3, 3].max(axis=0) == pytest.approx((x1 - (x1 - x0) / 10, y1 - (y1 - y0) / 10, -0.096))


def test_the_simulated_cell_reaches_most_grasps_with_an_assumed_gripper() -> None:
    step = checked(EXACT)
    assert (step.outcome, step.what_to_do) == ("ok", None)
    reached = int(step.message.split(" of 100 ")[0])
    assert reached >= 90
    assert "with a gripper of 174 mm, assumed because [gripper] does not describe one" in step.message


@pytest.mark.parametrize("preset", ["robotiq-2f-85", "robotiq-hand-e", "onrobot-rg2", "schunk-egp-50"])
def test_each_preset_reaches_most_grasps_in_the_simulated_cell(preset: str) -> None:
    step = checked(with_gripper(preset=preset))
    assert (step.outcome, step.what_to_do) == ("ok", None)
    assert "assumed" not in step.message


def test_with_a_short_gripper_the_camera_is_named() -> None:
    step = checked(with_gripper(length_m=0.1))
    assert step.outcome == "warning"
    assert step.message.startswith("0 of 100 upright grasps over the workspace reached, with a gripper of 100 mm")
    assert "the camera comes too near the table" in step.message
    assert step.what_to_do == ADVICE["collision-camera"]


def test_a_workspace_too_far_away_is_named() -> None:
    far = with_gripper(preset="robotiq-2f-85").model_copy(update={"workspace": WorkspaceSettings(x_m=(0.75, 1.1))})
    step = checked(far)
    assert step.outcome == "warning"
    assert "out of the arm's reach" in step.message
    assert step.what_to_do == ADVICE["out-of-reach"]
