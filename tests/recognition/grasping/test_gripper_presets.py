"""Grippers on the market: consistent dimensions, and an adapter between flange and gripper."""

from typing import get_args

import pytest

from recognition.grasping.gripper import Gripper
from recognition.grasping.gripper_presets import PRESETS, GripperPreset, with_adapter


@pytest.mark.parametrize("name", get_args(GripperPreset))
def test_the_body_of_a_preset_reaches_from_the_flange_to_the_fingers(name: GripperPreset) -> None:
    gripper = PRESETS[name]
    ranges = sorted((box.low_m[2], box.high_m[2]) for box in gripper.body)
    assert ranges[0][0] == 0.0
    covered = 0.0
    for low, high in ranges:
        assert low <= covered + 1e-9, "no gap between the boxes"
        covered = max(covered, high)
    # all of them end at the fingers, to 1 mm
    assert covered == pytest.approx(gripper.fingers.low_m[2], abs=0.001)
    assert gripper.fingers.high_m[2] == gripper.length_m


def test_the_default_gripper_has_its_palm_up_to_the_flange() -> None:
    (box,) = Gripper().body
    assert box.low_m == (-0.0475, -0.0375, 0.0)
    assert box.high_m == pytest.approx((0.0475, 0.0375, 0.134))


def test_an_adapter_moves_the_body_and_fills_the_gap() -> None:
    gripper = PRESETS["robotiq-hand-e"]
    longer = with_adapter(gripper, gripper.length_m + 0.02)
    assert longer.length_m == pytest.approx(0.1635)
    assert [(box.low_m[2], box.high_m[2]) for box in longer.body] == [
        pytest.approx((0.0, 0.02)),
        pytest.approx((0.02, 0.13)),
    ]
    shorter = with_adapter(gripper, gripper.length_m - 0.01)
    assert [(box.low_m[2], box.high_m[2]) for box in shorter.body] == [pytest.approx((0.0, 0.1))]
