"""The self-test of the camera: its description and its images."""

import numpy as np
import pytest

from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.devices import CameraInfo, Frame
from cell.self_test import camera_checks
from tests.cell.self_test.cells_to_check import (
    grounds_for,
    looking_cell,
)


def test_a_camera_that_does_not_see_the_workspace_is_detected() -> None:
    assert not camera_checks.looks_elsewhere(looking_cell())
    assert camera_checks.looks_elsewhere(looking_cell(aside_m=1.0))
    assert not camera_checks.looks_elsewhere(grounds_for(CellSettings())), "an unknown pose is no excuse"


@pytest.mark.parametrize(
    ("temperature_c", "warnings", "expected"),
    [
        (None, (), None),
        (60.0, (), None),
        (95.0, (), "95 degrees C; but that is hot"),
        (60.0, ("the link is USB 2: use another cable",), "but the link is USB 2"),
    ],
)
def test_the_description_of_a_camera_is_checked(
    temperature_c: float | None, warnings: tuple[str, ...], expected: str | None
) -> None:
    step = camera_checks.camera_found(CameraInfo("OAK-D-PRO", "1944", 640, 400, "USB 3", temperature_c, warnings))
    assert step.outcome == ("ok" if expected is None else "warning")
    assert step.message.startswith("OAK-D-PRO 1944, 640x400, USB 3")
    assert (expected or "") in step.message
    assert (step.what_to_do is None) == (expected is None)


@pytest.mark.parametrize(
    ("depth_m", "share", "age_s", "focal", "aside", "outcome", "expected"),
    [
        (0.5, 0.9, 0.6, 1.0, False, "ok", "90 % of the pixels measured, 0.50 to 0.50 m away"),
        (0.5, 0.1, 0.6, 1.0, False, "warning", "that is little"),
        (0.5, 0.1, 0.6, 1.0, True, "ok", "10 % of the pixels"),
        (0.1, 0.9, 0.6, 1.0, False, "warning", "most is nearer than the 0."),
        (0.5, 0.9, 0.6, 0.6, False, "warning", "degrees, and viewpoints are planned for"),
        (0.5, 0.9, 30.0, 1.0, False, "failed", "the frame has an age of 30.0 s"),
        (0.5, 0.9, -30.0, 1.0, False, "failed", "the frame has an age of -30.0 s"),
    ],
)
def test_a_depth_image_is_checked(
    depth_m: float, share: float, age_s: float, focal: float, aside: bool, outcome: str, expected: str
) -> None:
    optics = SimulatedCamera().optics
    depth = np.zeros((optics.height, optics.width), dtype=np.uint16)
    depth[: round(share * optics.height)] = round(depth_m / 1e-4)
    K = optics.K @ np.diag([focal, focal, 1.0])
    step = camera_checks.depth_image(Frame(depth, 1e-4, K, 0.0, 5), age_s, optics, aside)
    assert step.outcome == outcome
    assert expected in step.message
    assert (step.what_to_do is None) == (outcome == "ok")
