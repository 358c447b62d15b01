"""Rules that involve several sections of the settings. The sections are tested with the configuration file."""

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


def test_a_joint_speed_beyond_the_limit_of_ur_rtde_is_rejected() -> None:
    """ur_rtde would raise a ValueError at the first move."""
    assert SimulatedArm(speed_rad_s=3.14).speed_rad_s == 3.14
    with pytest.raises(ValidationError, match=r"less than or equal to 3\.14"):
        SimulatedArm(speed_rad_s=3.15)


def test_the_active_calibration_is_the_configured_file_or_that_of_the_folder(tmp_path: Path) -> None:
    assert HandEyeSettings().active_file is None
    assert HandEyeSettings(folder=tmp_path).active_file == tmp_path / "hand_eye.json"
    assert HandEyeSettings(folder=tmp_path, file=tmp_path / "x.json").active_file == tmp_path / "x.json"


@pytest.mark.parametrize(
    ("x_m", "y_m", "table_z_m"),
    [
        (AROUND, AROUND, 0.0),
        (AROUND, AROUND, -0.1),  # the base begins at 0, the workspace ends at 0.02
        (AROUND, AROUND, 0.3),  # a table above the base, through which the arm would pass
        ((0.07, 0.4), AROUND, 0.0),  # overlaps the foot by half a centimetre
        ((-0.4, -0.05), (0.05, 0.3), 0.0),  # overlaps the foot with a corner
    ],
)
def test_a_workspace_that_contains_the_base_is_rejected(
    x_m: tuple[float, float], y_m: tuple[float, float], table_z_m: float
) -> None:
    with pytest.raises(ValidationError, match=r"workspace: x_m .* contain the base of the arm.*: choose x_m or y_m"):
        cell(x_m, y_m, table_z_m)


@pytest.mark.parametrize(
    ("x_m", "y_m", "table_z_m"),
    [
        ((0.08, 0.4), AROUND, 0.0),
        ((0.06, 0.3), (0.06, 0.3), 0.0),  # the corner is 85 mm from the axis, the foot 75 mm
        (AROUND, AROUND, -0.12),  # the base is above the workspace
        (AROUND, AROUND, -0.5),
    ],
)
def test_a_workspace_beside_or_below_the_base_is_accepted(
    x_m: tuple[float, float], y_m: tuple[float, float], table_z_m: float
) -> None:
    assert cell(x_m, y_m, table_z_m).workspace.x_m == x_m
