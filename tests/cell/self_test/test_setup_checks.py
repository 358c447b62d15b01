"""The self-test of the setup: calibration, table and viewpoints."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from calibration.storage.hand_eye_file import load_hand_eye
from cell.config.cell_config import CellSettings, HandEyeSettings, ScanSettings, WorkspaceSettings
from cell.devices import ArmInfo, CameraInfo, View
from cell.self_test import setup_checks
from cell.self_test.table_check import distance_factor
from tests.cell.self_test.cells_to_check import (
    grounds_for,
    looking_cell,
    real_cell,
    written_hand_eye,
)

pytestmark = pytest.mark.slow


@pytest.fixture
def hand_eye_file(tmp_path: Path) -> Path:
    return written_hand_eye(tmp_path)


def test_a_calibration_is_compared_with_the_camera_and_robot(hand_eye_file: Path) -> None:
    context = grounds_for(real_cell("10.0.0.1", hand_eye_file))
    context.arm = ArmInfo("UR5", "2022", "5.25.1")
    assert setup_checks.calibration(context).outcome == "ok"
    context.hand_eye = None
    context.camera = CameraInfo("OAK-D-PRO", "777", 640, 400, "USB 3 (SUPER)", 40.0, ())
    step = setup_checks.calibration(context)
    assert step.outcome == "failed"
    assert "made with camera 1944, this is camera 777" in step.message
    assert "set hand_eye.file to the right file" in (step.what_to_do or "")
    assert context.hand_eye is None


def test_a_missing_or_old_calibration_is_reported(hand_eye_file: Path) -> None:
    settings = real_cell("10.0.0.1", hand_eye_file.with_name("none.json"))
    step = setup_checks.calibration(grounds_for(settings))
    assert (step.outcome, "there is no hand-eye calibration" in step.message) == ("failed", True)
    young = HandEyeSettings(file=hand_eye_file, max_age_days=2)
    step = setup_checks.calibration(grounds_for(settings.model_copy(update={"hand_eye": young})))
    assert (step.outcome, "3.0 days old" in step.message) == ("failed", True)
    assert step.what_to_do == "calibrate again"


def test_without_a_file_only_a_simulated_cell_has_a_calibration(tmp_path: Path, hand_eye_file: Path) -> None:
    none_yet = HandEyeSettings(folder=tmp_path / "none")
    real = real_cell("10.0.0.1", hand_eye_file).model_copy(update={"hand_eye": none_yet})
    step = setup_checks.calibration(grounds_for(real))
    assert (step.outcome, "there is no hand-eye calibration" in step.message) == ("failed", True)
    assert "`pointchain calibrate run`" in (step.what_to_do or "")
    step = setup_checks.calibration(grounds_for(CellSettings(hand_eye=none_yet)))
    assert (step.outcome, step.message) == ("ok", "that of the simulated cell")
    made = HandEyeSettings(folder=hand_eye_file.parent)
    step = setup_checks.calibration(grounds_for(CellSettings(hand_eye=made)))
    assert (step.outcome, str(hand_eye_file) in step.message) == ("ok", True)


def test_a_plain_matrix_is_accepted_with_a_warning(hand_eye_file: Path) -> None:
    hand_eye_file.write_text('{"T_flange_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1]]}')
    step = setup_checks.calibration(grounds_for(real_cell("10.0.0.1", hand_eye_file)))
    assert step.outcome == "warning"
    assert "does not say when it was made, so this is not checked" in step.message
    assert step.what_to_do == "calibrate again to record it"


@pytest.mark.parametrize(
    ("told_table_z_m", "outcome"), [(0.0, "ok"), (0.007, "warning"), (-0.03, "failed"), (-0.15, "failed")]
)
def test_the_height_of_the_table_is_compared_with_the_configuration(told_table_z_m: float, outcome: str) -> None:
    step = setup_checks.table(looking_cell(told_table_z_m))
    assert step.outcome == outcome, step
    assert (step.what_to_do is None) == (outcome == "ok")
    assert "mounting.table_z_m" in step.message


def test_more_height_error_is_accepted_from_farther_away_than_in_a_scan() -> None:
    context = looking_cell(0.0)
    frame = context.frame
    assert frame is not None
    for distance_m, factor in ((0.3, 1.0), (0.48, 1.0), (0.6, 1.5625)):
        depth = np.full_like(frame.depth, round(distance_m / frame.depth_unit_m))
        view = View(0, depth, frame.depth_unit_m, frame.K, np.eye(4), np.eye(4))
        assert distance_factor(view, context.settings) == pytest.approx(factor)


def test_a_table_out_of_view_is_skipped() -> None:
    step = setup_checks.table(looking_cell(aside_m=1.0))
    assert step.outcome == "skipped"
    assert "the camera sees 0 % of the workspace" in step.message


def test_a_table_that_is_not_fully_covered_is_a_warning() -> None:
    context = looking_cell()
    context.state = None
    step = setup_checks.viewpoints(context)
    assert (step.outcome, step.what_to_do) == ("ok", None)
    wider = context.settings.model_copy(update={"workspace": WorkspaceSettings(x_m=(0.2, 0.8), y_m=(-0.6, 0.6))})
    step = setup_checks.viewpoints(replace(context, settings=wider))
    assert step.outcome == "warning"
    assert "% of the table in the workspace" in step.message
    assert "x_m and y_m in [workspace] smaller" in (step.what_to_do or "")


def test_unreachable_viewpoints_are_reported_with_reasons() -> None:
    context = looking_cell()
    context.state = None
    far = context.settings.model_copy(
        update={"workspace": WorkspaceSettings(x_m=(0.7, 1.2)), "scan": ScanSettings(min_views=8)}
    )
    step = setup_checks.viewpoints(replace(context, settings=far))
    assert step.outcome == "failed"
    assert "reach" in step.message
    assert step.message.endswith("scan.min_views is 8")


@pytest.mark.parametrize(("degrees", "outcome"), [(110, "ok"), (151, "failed"), (180, "failed")])
def test_a_camera_that_looks_back_at_the_arm_sees_no_workspace(degrees: float, outcome: str) -> None:
    context = looking_cell()
    assert context.hand_eye is not None
    context.state = None
    turned = from_rotation_vector((0, -0.065, 0.045), (np.deg2rad(degrees), 0, 0))
    step = setup_checks.viewpoints(replace(context, hand_eye=replace(context.hand_eye, T_flange_camera=turned)))
    assert step.outcome == outcome, step
    if outcome == "ok":
        return
    assert step.message.startswith(f"by the hand-eye file the camera looks back at the arm, {degrees} degrees from")
    assert step.message.endswith("so that the arm itself hides the workspace")
    assert (step.what_to_do or "").startswith("check that quat_xyzw has the order x, y, z, w")


@pytest.mark.parametrize("decimals", [4, 5, 6])
def test_a_rounded_matrix_reaches_as_many_viewpoints_as_an_exact_one(tmp_path: Path, decimals: int) -> None:
    T = from_rotation_vector((0.0, -0.065, 0.045), (0.02, 0.01, 0.03))
    path = tmp_path / "hand_eye.json"
    path.write_text(json.dumps({"T_flange_camera": T.round(decimals).tolist()}))
    context = looking_cell()
    context.state = None
    step = setup_checks.viewpoints(replace(context, hand_eye=load_hand_eye(path, 1.0)))
    assert step.message.startswith("8 of 8 reached")
