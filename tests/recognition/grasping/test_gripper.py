"""Dimensions of the gripper, and distances from its swept volume, computed by hand."""

import math
from typing import Any

import numpy as np
import pytest

from recognition.errors import InvalidGripperError
from recognition.grasping.gripper import Gripper, GripperBox, swept_distance

GRIPPER = Gripper(finger_width_m=0.01, finger_thickness_m=0.005, finger_depth_m=0.04, stroke_m=0.08, palm_width_m=0.06)
"""With the opening and reach below: fingers from x = 6 to 11, |y| <= 5, z <= 3; palm |x| <= 45, |y| <= 30, z <= -37."""
OPENING, REACH = 0.012, 0.003


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((8, 0, 0), 0),  # in a finger
        ((-8, 5, 3), 0),  # on the other finger's corner
        ((0, 0, 0), 6),  # half way between the fingers
        ((8, 0, 7), 4),  # under a fingertip
        ((14, 9, 0), 5),  # beside a finger, 3 and 4
        ((14, 7, 9), 7),  # 3, 2 and 6 from its lowest corner
        ((8, 0, -500), 0),  # where a finger comes from
        ((30, 0, -30), 7),  # 7 under the palm
        ((0, 20, -40), 0),  # in the palm
        ((48, 34, -100), 5),  # beside the palm's corner, 3 and 4
    ],
)
def test_distances_by_hand(point: tuple[float, float, float], expected: float) -> None:
    found = swept_distance(np.array([point]) / 1000, np.array([OPENING]), np.array([REACH]), GRIPPER, np.array([False]))
    np.testing.assert_allclose(found, expected / 1000, rtol=0, atol=1e-12)


def test_the_space_between_the_fingers_counts_for_points_that_must_not_be_gripped() -> None:
    points = np.array([(0, 0, 0), (0, 0, 5), (14, 9, 0)]) / 1000
    found = swept_distance(points, np.full(3, OPENING), np.full(3, REACH), GRIPPER, np.full(3, True))
    np.testing.assert_allclose(found, (0, 0.002, 0.005), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"stroke_m": 0.0}, "stroke_m is 0 m; it must be positive"),
        ({"finger_width_m": -0.01}, "finger_width_m is -0.01 m"),
        ({"table_clearance_m": -0.001}, "table_clearance_m"),
        ({"stroke_m": 85}, "metres, not mm"),
        ({"finger_depth_m": math.nan}, "finger_depth_m is nan"),
        ({"finger_depth_m": math.inf}, "finger_depth_m is inf"),
        ({"palm_width_m": "wide"}, "palm_width_m is 'wide'"),
        ({"clearance_m": True}, "clearance_m is True"),
        ({"length_m": 0.04}, "length_m is 0.04 m; it must be more than finger_depth_m, 0.04 m"),
        ({"mounting_rotation_rad": 90.0}, "mounting_rotation_rad is 90.0; an angle from -2 pi to 2 pi is needed"),
        ({"body_m": (GripperBox((0, 0, 0), (0.1, 0.1, 0)),)}, "box 1 reaches from z = 0 to 0 m"),
        ({"body_m": (GripperBox((0, 0, 0), (80, 0.1, 0.1)),)}, "give metres, not mm"),
    ],
)
def test_invalid_dimensions_are_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(InvalidGripperError) as refused:
        Gripper(**wrong)
    assert said in str(refused.value)


def test_margins_may_be_zero() -> None:
    assert Gripper(opening_margin_m=0, clearance_m=0, table_clearance_m=0).clearance_m == 0
