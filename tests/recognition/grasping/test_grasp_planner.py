"""Grasps with known values, and properties of the grasps on random chains."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.grasping.candidates import MAX_RELEVANT_DISTANCE_M
from recognition.grasping.grasp_list import list_grasps
from recognition.grasping.grasp_planner import MIN_REACH_SHARE
from recognition.grasping.gripper import Gripper
from recognition.grasping.obstacles import gather_obstacles
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.model import PointChainModel
from recognition.registration.fusion import VOXEL_RADII
from tests.recognition.straight_strings import (
    GRIPPER,
    HALF_FINGER,
    NOTHING,
    PARAMETERS,
    TABLE_Z,
    R,
    chain,
    grasps_of,
    straight,
)

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("degrees", [0, 37, 180, -110])
def test_a_straight_string_is_grasped_from_above_and_across(degrees: float) -> None:
    grasps, notes = grasps_of(straight(degrees=degrees))
    assert notes == ()
    # About every 5 mm, except half a finger from the ends.
    s = np.sort([grasp.s_m for grasp in grasps])
    np.testing.assert_allclose((s[0], s[-1]), (HALF_FINGER, 0.2 - HALF_FINGER), rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.diff(s), 0.005, rtol=0, atol=1e-9)
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])
    for grasp in grasps:
        T = grasp.T_base_grasp
        np.testing.assert_allclose(T[:3, 1], along, rtol=0, atol=1e-9)
        np.testing.assert_allclose(T[:3, 2], (0, 0, -1), rtol=0, atol=1e-9)
        np.testing.assert_allclose(T[:3, 0], (-along[1], along[0], 0), rtol=0, atol=1e-9)
        np.testing.assert_allclose(T[:3, 3], (grasp.s_m - 0.1) * along + (0, 0, TABLE_Z + R), rtol=0, atol=1e-9)
        assert grasp.opening_m == pytest.approx(2 * R + GRIPPER.opening_margin_m, abs=1e-9)
        # The table stops the fingertips before they reach the string's lowest point.
        assert grasp.reach_m == pytest.approx(R - GRIPPER.table_clearance_m, abs=1e-9)
        assert grasp.table_clearance_m == pytest.approx(GRIPPER.table_clearance_m, abs=1e-9)
        assert grasp.clearance_m == MAX_RELEVANT_DISTANCE_M
    # The best is in the middle, and they come in order.
    assert min(grasps[0].s_m, 0.2 - grasps[0].s_m) > MAX_RELEVANT_DISTANCE_M
    scores = [grasp.score for grasp in grasps]
    assert scores == sorted(scores, reverse=True)
    assert 0 < scores[-1] < scores[0] <= 1


def test_the_opening_grows_with_sigma_and_bend() -> None:
    uncertain = replace(straight(), sigma_m=np.full(51, 0.001))
    grasps, _ = grasps_of(uncertain)
    assert {round(grasp.opening_m, 9) for grasp in grasps} == {0.0164}  # 8.4 + 2 * 2 sigma + 4
    sure = grasps_of(straight())[0][0].score
    assert grasps[0].score == pytest.approx(sure / (1 + (2 / 4.2) ** 2), rel=1e-6)

    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = chain(np.column_stack([0.03 * np.cos(t), 0.03 * np.sin(t), np.full(400, TABLE_Z + R)]), closed=True)
    grasps, _ = grasps_of(ring)
    # Half a finger along a circle of 30 mm, it is 5^2 / 60 mm off the tangent.
    bend = 0.03 * (1 - np.cos(HALF_FINGER / 0.03))
    np.testing.assert_allclose([grasp.opening_m for grasp in grasps], 0.0124 + 2 * bend, rtol=0, atol=2e-5)
    # All around: a closed chain has no end.
    assert len(grasps) == int(ring.length_m / 0.005) + 1
    scores = [grasp.score for grasp in grasps]
    assert max(scores) - min(scores) < 0.01


def test_no_grasp_where_no_view_saw_the_string() -> None:
    seen = straight()
    views = seen.views.copy()
    views[25] = 0  # at 100 mm; its neighbours, 4 mm on, were seen
    grasps, _ = grasps_of(replace(seen, views=views))
    away = np.abs([grasp.s_m - 0.1 for grasp in grasps])
    assert HALF_FINGER < away.min() < HALF_FINGER + 0.009
    few = replace(seen, views=np.ones(51, dtype=np.int64))
    assert grasps_of(few)[0][0].score == pytest.approx(grasps_of(seen)[0][0].score / 3, rel=1e-6)


@pytest.mark.parametrize(
    ("apart", "margin_share"),
    [(0.0085, None), (0.0145, None), (0.0157, 0.5), (0.0175, 0.5), (0.0195, 1.0), (0.03, 1.0)],
)
def test_strands_side_by_side_need_room_for_a_finger(apart: float, margin_share: float | None) -> None:
    # A finger's outer face is 6.2 + 5 mm from the centre line, or 5.2 + 5 mm with half the margin. The other strand
    # begins r before its own, and 1 mm is kept: from 15.4 mm on there is room, and from 18.4 mm on 3 mm of it.
    grasps, notes = grasps_of(straight(), straight(y=apart, number=1))
    assert bool(grasps) == (margin_share is not None)
    if margin_share is not None:
        opening = 2 * R + margin_share * GRIPPER.opening_margin_m
        assert {round(grasp.opening_m, 6) for grasp in grasps} == {round(opening, 6)}
        assert all(grasp.T_base_grasp[2, 2] == -1 for grasp in grasps)
        outer = opening / 2 + GRIPPER.finger_thickness_m + R
        assert {round(grasp.clearance_m, 6) for grasp in grasps} == {round(apart - outer, 6)}
    else:
        assert len(notes) == 2
        assert "would touch" in notes[0].message


def test_a_stroke_smaller_than_the_string_is_a_note() -> None:
    grasps, notes = grasps_of(straight(), gripper=Gripper(stroke_m=0.012))
    assert grasps == ()
    (note,) = notes
    assert "too wide" in note.message
    assert "12.4 mm" in note.message  # 8.4 + 4
    assert "opens 12.0 mm" in note.message


def test_a_string_too_thin_for_fingers_above_the_table_is_a_note() -> None:
    thin = replace(straight(z=0.001), radius_m=0.001)
    grasps, notes = grasps_of(thin)
    assert grasps == ()
    assert "touch the table" in notes[0].message
    # Fingertips that may come closer to the table reach the least share of the radius beyond the centre line.
    grasps, _ = grasps_of(thin, gripper=Gripper(min_table_clearance_m=0.0005))
    assert {round(grasp.reach_m, 6) for grasp in grasps} == {round(MIN_REACH_SHARE * 0.001, 6)}


def test_a_chain_shorter_than_a_finger_is_a_note() -> None:
    grasps, notes = grasps_of(straight(length=0.009))
    assert grasps == ()
    assert "its length of 9 mm is not more than the width of a finger" in notes[0].message


def test_no_string_no_grasp() -> None:
    assert grasps_of() == ((), ())


def test_a_long_string_has_grasps_along_its_whole_length() -> None:
    grasps, _ = grasps_of(straight(length=10.0))
    s = np.sort([grasp.s_m for grasp in grasps])
    assert len(s) == 100
    np.testing.assert_allclose(np.diff(s), (10 - 2 * HALF_FINGER) / 99, rtol=0, atol=1e-9)


def test_reversing_the_chain_turns_the_grasps() -> None:
    (there, _), (back, _) = grasps_of(straight()), grasps_of(replace(straight(), points=straight().points[::-1].copy()))
    assert len(there) == len(back)
    by_position = {round(0.2 - grasp.s_m, 6): grasp for grasp in back}
    for grasp in there:
        other = by_position[round(grasp.s_m, 6)].T_base_grasp
        np.testing.assert_allclose(other[:, :2], -grasp.T_base_grasp[:, :2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(other[:, 2:], grasp.T_base_grasp[:, 2:], rtol=0, atol=1e-9)


@st.composite
def odd_chains(draw: st.DrawFn) -> tuple[Chain, ...]:
    """Random chains: some have steps of zero length, some a single point, some are above or below the table."""
    chains = []
    for number in range(draw(st.integers(1, 3))):
        rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
        count = draw(st.integers(1, 30))
        steps = rng.normal(0, draw(st.sampled_from((0.0, 0.001, 0.004, 0.05))), (count, 3))
        begin = np.array([0, 0, TABLE_Z + draw(st.sampled_from((-0.01, 0.0, R, 0.05)))])
        points = begin + np.cumsum(steps, axis=0)
        chains.append(
            Chain(
                number, draw(st.booleans()), draw(st.sampled_from((0.0005, R, 0.02))), points,
                rng.uniform(0, 0.002, count), rng.integers(0, 9, count), ("free", "unobserved"),
            )
        )  # fmt: skip
    return tuple(chains)


@settings(max_examples=50, deadline=None)
@given(odd_chains(), st.integers(0, 60), st.floats(0, 0.1))
def test_grasps_on_random_chains_are_possible(chains: tuple[Chain, ...], count: int, spread: float) -> None:
    surface = np.random.default_rng(count).normal((0, 0, TABLE_Z), spread, (count, 3))
    crossings = tuple(
        Crossing(k, np.zeros(3), StrandPoint(a.id, a.length_m / 3), StrandPoint(b.id, b.length_m / 2), 0, 1, 1, 0.6)
        for k, (a, b) in enumerate(pairwise(chains))
    )
    grasps, notes = grasps_of(*chains, crossings=crossings, surface=surface)
    assert len({grasp.chain for grasp in grasps}) + len(notes) == len(chains)
    for grasp in grasps:
        T = grasp.T_base_grasp
        assert np.isfinite(T).all()
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), rtol=0, atol=1e-9)
        assert 0 <= grasp.s_m <= chains[grasp.chain].length_m
        assert 2 * chains[grasp.chain].radius_m < grasp.opening_m <= GRIPPER.stroke_m
        assert GRIPPER.clearance_m <= grasp.clearance_m <= MAX_RELEVANT_DISTANCE_M
        assert grasp.table_clearance_m >= GRIPPER.min_table_clearance_m - 1e-9
        assert grasp.reach_m >= MIN_REACH_SHARE * chains[grasp.chain].radius_m - 1e-9
        assert 0 <= grasp.score <= 1


def test_the_document_holds_grasps_to_a_micrometre() -> None:
    string = straight(degrees=33)
    found, _ = grasps_of(string)
    obstacles = gather_obstacles((string,), NOTHING, VOXEL_RADII * R)
    grasps = list_grasps(found, (string,), (), obstacles, GRIPPER)
    document = PointChainModel("enhanced", PARAMETERS, (string,), grasps=grasps).to_json()
    assert len(document["grasps"]) == len(grasps)
    written, grasp = document["grasps"][0], grasps[0]
    np.testing.assert_allclose(written["T_base_grasp"], grasp.T_base_grasp, rtol=0, atol=5e-7)
    # Rotations keep all their digits; otherwise the frame would no longer be rigid.
    rotation = np.array(written["T_base_grasp"])[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-8)
    assert written["s_m"] == pytest.approx(grasp.s_m, abs=5e-7)
    assert written["score"] == pytest.approx(grasp.score, abs=5e-5)
