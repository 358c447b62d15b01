"""What a cell's settings refuse as a whole: the sections' own tests are those of the configuration file."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from cell.config.arm_config import ArmModelName, SimulatedArm
from cell.config.cell_config import CellSettings, HandEyeSettings, MountingSettings, WorkspaceSettings

AROUND = (-0.2, 0.2)


def cell(
    x_m: tuple[float, float], y_m: tuple[float, float], table_z_m: float = 0.0, model: ArmModelName = "ur5e"
) -> CellSettings:
    return CellSettings(
        arm=SimulatedArm(model=model),
        workspace=WorkspaceSettings(x_m=x_m, y_m=y_m, top_m=0.12),
        mounting=MountingSettings(table_z_m=table_z_m),
    )


def test_no_joint_speed_is_taken_that_the_robots_library_would_refuse() -> None:
    """Above it, it raises a ValueError when the first move is sent."""
    assert SimulatedArm(speed_rad_s=3.14).speed_rad_s == 3.14
    with pytest.raises(ValidationError, match=r"less than or equal to 3\.14"):
        SimulatedArm(speed_rad_s=3.15)


def test_the_calibration_in_use_is_the_named_file_else_that_in_the_folder(tmp_path: Path) -> None:
    assert HandEyeSettings().active_file is None
    assert HandEyeSettings(folder=tmp_path).active_file == tmp_path / "hand_eye.json"
    assert HandEyeSettings(folder=tmp_path, file=tmp_path / "x.json").active_file == tmp_path / "x.json"


@pytest.mark.parametrize(
    ("x_m", "y_m", "table_z_m"),
    [
        (AROUND, AROUND, 0.0),
        (AROUND, AROUND, -0.1),  # the base stands from 0 up, the workspace ends at 0.02
        (AROUND, AROUND, 0.3),  # a table over the base: the arm would come through it
        ((0.07, 0.4), AROUND, 0.0),  # half a centimetre of the foot
        ((-0.4, -0.05), (0.05, 0.3), 0.0),  # a corner
    ],
)
def test_a_workspace_that_holds_the_arms_base_is_refused(
    x_m: tuple[float, float], y_m: tuple[float, float], table_z_m: float
) -> None:
    with pytest.raises(ValidationError, match=r"workspace: x_m .* contain the base of the arm.*: choose x_m or y_m"):
        cell(x_m, y_m, table_z_m)


@pytest.mark.parametrize(
    ("x_m", "y_m", "table_z_m"),
    [
        ((0.08, 0.4), AROUND, 0.0),
        ((0.06, 0.3), (0.06, 0.3), 0.0),  # the corner is 85 mm from the axis, the foot 75 mm
        (AROUND, AROUND, -0.12),  # the base is above all of it
        (AROUND, AROUND, -0.5),
    ],
)
def test_a_workspace_beside_the_base_or_below_it_is_taken(
    x_m: tuple[float, float], y_m: tuple[float, float], table_z_m: float
) -> None:
    assert cell(x_m, y_m, table_z_m).workspace.x_m == x_m
