"""Positions along chains that a gripper could take, and the reasons for the positions that it could not."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.grasping.candidates import (
    MAX_POSITIONS_PER_CHAIN,
    MAX_RELEVANT_DISTANCE_M,
    NO_ROOM,
    STEP_M,
    GraspCandidates,
    find_candidates,
)
from recognition.grasping.gripper import Gripper
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.parameters import ChainParameters

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
GRIPPER = Gripper()
HALF_FINGER = GRIPPER.finger_width_m / 2
EXACT = 1e-9
"""Tolerance for rounding, metres."""


def chain(points: NDArray[np.float64], closed: bool = False, r: float = R) -> Chain:
    n = len(points)
    return Chain(0, closed, r, points, np.zeros(n), np.full(n, 3, dtype=np.int64), ("free", "free"))


def straight(length: float = 0.2, r: float = R, slope_deg: float = 0.0) -> Chain:
    """A string that leads to x and y alike, in steps of 4 mm, and rises."""
    slope = np.radians(slope_deg)
    way = np.array([np.cos(slope) / np.sqrt(2), np.cos(slope) / np.sqrt(2), np.sin(slope)])
    return chain(np.linspace(0.0, length, round(length / 0.004) + 1)[:, None] * way + (0.3, -0.1, r), r=r)


def ring(radius: float = 0.05, count: int = 200) -> Chain:
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return chain(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, R)]), closed=True)


def crossing(over: tuple[int, float], under: tuple[int, float], confidence: float = 1.0) -> Crossing:
    at = (StrandPoint(*over), StrandPoint(*under))
    return Crossing(0, np.zeros(3), *at, 2 * R, np.pi / 2, 1, confidence)


def candidates(chain: Chain, *crossings: Crossing, gripper: Gripper = GRIPPER) -> GraspCandidates:
    found, _ = find_candidates(chain, crossings, PARAMETERS, gripper)
    assert found is not None
    return found


def reason(chain: Chain, *crossings: Crossing, gripper: Gripper = GRIPPER) -> str:
    """The reason why there is no candidate."""
    found, message = find_candidates(chain, crossings, PARAMETERS, gripper)
    assert found is None or len(found.s_m) == 0
    return message


def test_a_straight_string_has_positions_every_step_except_half_a_finger_from_its_ends() -> None:
    string = straight()
    found = candidates(string)
    np.testing.assert_allclose(found.s_m, np.linspace(0.005, 0.195, 39), rtol=0, atol=EXACT)
    way = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    np.testing.assert_allclose(found.point, string.points[0] + found.s_m[:, None] * way, rtol=0, atol=EXACT)
    np.testing.assert_allclose(found.direction, np.tile(way, (39, 1)), rtol=0, atol=EXACT)
    np.testing.assert_allclose(found.opening_m, 2 * R + GRIPPER.opening_margin_m, rtol=0, atol=EXACT)
    # Half the score at the ends, and the full score `MAX_RELEVANT_DISTANCE_M` from the finger.
    to_end = np.minimum(found.s_m, 0.2 - found.s_m) - HALF_FINGER
    np.testing.assert_allclose(
        found.base_score, 0.5 + 0.5 * np.minimum(to_end / MAX_RELEVANT_DISTANCE_M, 1), rtol=0, atol=1e-6
    )


def test_the_remaining_positions_are_counted_with_the_obstacles() -> None:
    _, message = find_candidates(straight(), (), PARAMETERS, GRIPPER)
    assert message == f"of 39 positions along it, 39 are {NO_ROOM}"


def test_a_long_string_has_fewer_positions_per_metre() -> None:
    found = candidates(straight(length=3.0))
    assert len(found.s_m) == MAX_POSITIONS_PER_CHAIN
    np.testing.assert_allclose(np.diff(found.s_m), 2.99 / 99, rtol=0, atol=EXACT)


@pytest.mark.parametrize("length", [0.0104, 0.014])
def test_a_string_little_longer_than_a_finger_has_one_position(length: float) -> None:
    points = np.array([(0.0, 0.0, R), (length, 0.0, R)])
    np.testing.assert_allclose(candidates(chain(points)).s_m, [HALF_FINGER], rtol=0, atol=EXACT)


def test_a_string_shorter_than_a_finger_has_none() -> None:
    assert reason(straight(length=0.008)) == "its length of 8 mm is not more than the width of a finger"
    found, message = find_candidates(chain(np.array([(0.0, 0.0, R)])), (), PARAMETERS, GRIPPER)
    assert (found, message) == (None, "its length of 0 mm is not more than the width of a finger")


def test_a_closed_string_has_positions_all_around() -> None:
    string = ring()
    found = candidates(string)
    count = int(string.length_m / STEP_M) + 1
    np.testing.assert_allclose(found.s_m, np.arange(count) * string.length_m / count, rtol=0, atol=EXACT)
    # The seam is a position like the others, except for the corners of the polygon with sides of 1.6 mm.
    bend = 0.05 * (1 - np.cos(HALF_FINGER / 0.05))
    corner = 0.05 * (1 - np.cos(np.pi / 200))
    wanted = 2 * (R + bend) + GRIPPER.opening_margin_m
    np.testing.assert_allclose(found.opening_m, wanted, rtol=0, atol=4 * corner)
    np.testing.assert_allclose(found.base_score, found.base_score[0], rtol=0.01)
    # Along the tangent, up to half the angle of a corner.
    tangent = np.column_stack([-found.point[:, 1], found.point[:, 0]]) / 0.05
    assert ((found.direction[:, :2] * tangent).sum(axis=1) > np.cos(np.pi / 200) - 1e-3).all()


@pytest.mark.parametrize("r", [0.002, R])
def test_none_near_a_pass_underneath(r: float) -> None:
    string = straight(r=r)
    free, found = candidates(string), candidates(string, crossing(over=(1, 0.3), under=(0, 0.1)))
    # Three radii of this string, as `r_cn` is of the parameters', and half a finger.
    away = 3 * r + HALF_FINGER
    np.testing.assert_array_equal(found.s_m, free.s_m[np.abs(free.s_m - 0.1) >= away])
    assert len(found.s_m) < len(free.s_m)


def test_a_pass_underneath_at_the_seam_counts_on_both_sides() -> None:
    string = ring()
    found, away = candidates(string, crossing(over=(1, 0.3), under=(0, 0.002))), 3 * R + HALF_FINGER
    assert 0.002 + away <= found.s_m[0] < 0.002 + away + STEP_M
    assert 0.002 - away - STEP_M < found.s_m[-1] - string.length_m <= 0.002 - away


def test_an_upper_pass_has_a_lower_score() -> None:
    free, found = candidates(straight()), candidates(straight(), crossing(over=(0, 0.1), under=(1, 0.3)))
    np.testing.assert_array_equal(found.s_m, free.s_m)
    assert found.base_score[19] == pytest.approx(0.5, abs=1e-6)
    far = np.abs(free.s_m - 0.1) > MAX_RELEVANT_DISTANCE_M + EXACT
    np.testing.assert_allclose(found.base_score[far], free.base_score[far], rtol=0, atol=1e-12)


def test_an_upper_pass_of_an_uncertain_crossing_has_no_position() -> None:
    uncertain = crossing(over=(0, 0.1), under=(1, 0.3), confidence=0.8)
    assert np.abs(candidates(straight(), uncertain).s_m - 0.1).min() >= 3 * R + HALF_FINGER


def test_no_position_where_a_finger_would_hold_an_unseen_part() -> None:
    seen = straight()
    # Hidden from 80 to 100 mm, and a finger reaches 5 mm: 75 mm and 105 mm are too near.
    hidden = (seen.arc_length_m > 0.079) & (seen.arc_length_m < 0.101)
    found = candidates(replace(seen, views=np.where(hidden, 0, 3)))
    left = [k * 0.005 for k in range(1, 40) if not 15 <= k <= 21]
    np.testing.assert_allclose(found.s_m, left, rtol=0, atol=EXACT)
    # One of the three views that give the full score.
    one = candidates(replace(seen, views=np.ones(51, dtype=np.int64)))
    np.testing.assert_allclose(one.base_score, candidates(seen).base_score / 3, rtol=1e-9)


def test_an_unseen_string_has_no_position() -> None:
    unseen = replace(straight(), views=np.zeros(51, dtype=np.int64))
    assert reason(unseen) == "of 39 positions along it, 39 are not seen by any view"


def test_a_string_underneath_another_along_its_whole_length_has_no_position() -> None:
    string = straight(length=0.03)
    message = reason(string, crossing(over=(1, 0.3), under=(0, 0.015)))
    assert message == "of 5 positions along it, 5 are underneath another strand at a crossing, or beside it"


def test_a_string_too_thick_for_the_gripper_has_no_position() -> None:
    # 2 * 10 mm + 4 mm.
    message = reason(straight(r=0.01), gripper=Gripper(stroke_m=0.0239))
    assert message == (
        "of 39 positions along it, 39 are too wide: "
        "they need an opening of at least 24.0 mm, and the gripper opens 23.9 mm"
    )
    assert len(candidates(straight(r=0.01), gripper=Gripper(stroke_m=0.0241)).s_m) == 39
    # The opening includes the uncertainty: two sigma on either side.
    uncertain = replace(straight(), sigma_m=np.full(51, 0.002))
    np.testing.assert_allclose(candidates(uncertain).opening_m, 2 * (R + 0.004) + 0.004, rtol=0, atol=EXACT)
    assert "an opening of at least 20.4 mm" in reason(uncertain, gripper=Gripper(stroke_m=0.02))


def test_a_steep_string_has_no_position() -> None:
    # A string can be grasped from above up to a slope of 60 degrees.
    assert reason(straight(slope_deg=61)) == "of 39 positions along it, 39 are too steep"
    found = candidates(straight(slope_deg=59))
    assert len(found.s_m) == 39
    np.testing.assert_allclose(found.direction[:, 2], 0.0, rtol=0, atol=1e-12)
    assert found.base_score.max() == pytest.approx(np.cos(np.radians(59)), rel=1e-6)


def test_each_position_is_counted_once_with_its_first_reason() -> None:
    seen = straight()
    # Hidden up to 88 mm, and seen by one of three views from 89.3 mm on: 5 to 90 mm are too near. Of the rest, 95 to
    # 155 mm are within 17.6 mm of a pass underneath. 160 to 195 mm are left.
    half = replace(seen, views=np.where(seen.arc_length_m < 0.0915, 0, 3))
    message = reason(
        half,
        *(crossing(over=(1, 0.1), under=(0, s)) for s in (0.08, 0.11, 0.14)),
        gripper=Gripper(stroke_m=0.012),
    )
    unseen, under, wide = 18, 13, 8
    assert message == (
        f"of 39 positions along it, {unseen} are not seen by any view; "
        f"{under} are underneath another strand at a crossing, or beside it; "
        f"{wide} are too wide: they need an opening of at least 12.4 mm, and the gripper opens 12.0 mm"
    )
