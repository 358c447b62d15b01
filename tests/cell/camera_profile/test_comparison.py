"""Comparison of profiles, and what the self-test says about it."""

from dataclasses import replace

import pytest

from cell.camera_profile.comparison import compare
from cell.self_test.depth_quality import quality_found
from tests.cell.camera_profile.test_depth_profile import PROFILE

OTHER = replace(PROFILE, temporal_m=0.002, rest_m=0.0005)


def test_a_camera_like_the_expected_ones_passes() -> None:
    step = quality_found(replace(PROFILE, temporal_m=0.0012), [PROFILE, OTHER], 0.6)
    assert step.outcome == "ok"
    assert "the stated accuracy may be expected" in step.message
    assert "0.50 mm to 2.00 mm" in step.message
    assert step.figures is not None
    assert step.figures["as_expected"] is True


def test_a_noisy_table_is_a_warning_with_advice() -> None:
    step = quality_found(replace(PROFILE, temporal_m=0.004, hole_share=0.2), [PROFILE, OTHER], 0.6)
    assert step.outcome == "warning"
    assert "temporal noise above" in step.message
    assert "holes above" in step.message
    assert "camera.ir_dots" in (step.what_to_do or "")
    assert step.figures is not None
    assert step.figures["above_limit"] == ["temporal_m", "hole_share"]


def test_a_far_table_is_named() -> None:
    step = quality_found(replace(PROFILE, temporal_m=0.004), [PROFILE], 0.4)
    assert "beyond camera.working_m" in step.message
    assert "move the arm by hand" in (step.what_to_do or "")


def test_expected_errors_are_those_at_the_measured_distance() -> None:
    near = replace(PROFILE, distance_m=0.25)
    (ripple,) = [one for one in compare(PROFILE, [near]) if one.quantity.field == "ripple_m"]
    assert ripple.high == pytest.approx(0.004)
    assert ripple.is_good


def test_what_is_unknown_is_not_compared() -> None:
    fields = [one.quantity.field for one in compare(replace(PROFILE, temporal_m=None), [PROFILE])]
    assert "temporal_m" not in fields
    assert "ripple_m" in fields
