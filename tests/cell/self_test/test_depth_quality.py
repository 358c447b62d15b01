"""The self-test of the depth, with the settings of a real camera and images of simulated tables."""

import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cell.camera_profile.measure import SeenTable, TablePose
from cell.config.camera_config import OakCamera
from cell.config.camera_optics import oak_optics
from cell.config.rendering_options import RenderingOptions, TableTop
from cell.devices import Burst, Frame
from cell.self_test.check_result import CheckContext
from cell.self_test.depth_quality import depth_quality, quality_found
from cell.simulation.profiling.expected_profile import model_of_oak
from cell.simulation.profiling.table_view import TableViewing, view_table
from cell.simulation.rendering.depth_camera import camera_model
from tests.cell.camera_profile.test_depth_profile import PROFILE
from tests.cell.self_test.cells_to_check import grounds_for, real_cell

pytestmark = pytest.mark.slow

TABLE = TablePose(np.array([0.0, np.sin(0.25), np.cos(0.25)]) / 0.45)
EXPOSURES = 6


@cache
def burst_of(table_top: TableTop) -> Burst:
    """Return exposures that an OAK-D Pro may take of a table."""
    viewing = TableViewing(RenderingOptions(table_top=table_top), 4, EXPOSURES)
    (images,) = view_table(camera_model("oak-d-pro"), [TABLE], viewing)
    return Burst(images.depth, images.depth_unit_m, np.arange(EXPOSURES) / 30)


def context_of(burst: Burst) -> CheckContext:
    context = grounds_for(real_cell("10.0.0.1", Path("none.json")))
    context.burst = burst
    context.frame = Frame(burst.depth[0], burst.depth_unit_m, camera_model("oak-d-pro").K, time.time(), 1)
    return context


def test_a_real_camera_is_compared_with_a_simulated_one_of_its_kind() -> None:
    step = depth_quality(context_of(burst_of("printed")))
    assert step.outcome == "ok", step
    assert "the stated accuracy may be expected" in step.message
    assert step.figures is not None
    assert step.figures["measured"]["exposures"] == 5
    assert len(step.figures["expected"]) == 2
    assert step.figures["measured"]["focal_baseline_px_m"] == pytest.approx(402.5 * 0.075)


def test_a_bare_table_is_a_warning() -> None:
    step = depth_quality(context_of(burst_of("bare")))
    assert step.outcome == "warning"
    assert "temporal noise above" in step.message
    assert "camera.ir_dots" in (step.what_to_do or "")


def test_without_a_table_nothing_is_compared() -> None:
    burst = burst_of("printed")
    step = depth_quality(context_of(replace(burst, depth=np.zeros_like(burst.depth))))
    assert step.outcome == "skipped"
    assert "no image shows a table" in step.message
    assert "point the camera at the empty table" in (step.what_to_do or "")


@pytest.mark.parametrize(
    ("product", "like", "baseline_m"),
    [("oak-d", "oak-d-pro", 0.075), ("oak-d-sr", "oak-d-sr", 0.020), ("oak4-d", "oak-d-pro", 0.075)],
)
def test_each_product_has_a_simulated_camera(product: str, like: str, baseline_m: float) -> None:
    camera = OakCamera.model_validate({"kind": "oak", "product": product, "width": 1280, "height": 800})
    K = oak_optics(camera.product, 1280, 800, False, None).K
    model = model_of_oak(camera, SeenTable(TABLE, K, (1280, 800), 1e-4, 5))
    assert model.name == like
    assert (model.width, model.height, model.focal_px) == (1280, 800, K[0, 0])
    assert model.stereo is not None
    assert model.stereo.baseline_m == baseline_m
    # the search reaches the nearest measurable distance, or that of the preset
    assert model.stereo.disparities >= 0.9 * model.focal_px * baseline_m / camera.optics.near_m


def test_wrong_matches_are_no_warp() -> None:
    step = quality_found(replace(PROFILE, ripple_m=0.01, warp_m=0.1), [PROFILE], 0.6)
    assert step.figures is not None
    assert step.figures["above_limit"] == ["ripple_m"]
    step = quality_found(replace(PROFILE, warp_m=0.1), [PROFILE], 0.6)
    assert step.figures is not None
    assert step.figures["above_limit"] == ["warp_m"]
