"""Grasps with known answers, and that none of those on simulated tangles touches the true strings."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from cell.simulation.scenes import make_scene
from recognition.crossings import find_crossings
from recognition.grasp_places import FAR_M
from recognition.grasps import find_grasps
from recognition.gripper import Gripper
from recognition.joining import Strand
from recognition.model import Chain, Crossing, Grasp, PointChainModel, StrandPoint
from recognition.parameters import ChainParameters
from recognition.preprocess import Scene
from service.model_schema import GraspDocument

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
GRIPPER = Gripper()
HALF_FINGER = GRIPPER.finger_width_m / 2
NOTHING = np.empty((0, 3))
TABLE_Z = 0.3
"""Not 0, so that heights above the table and heights are told apart."""


def chain(points: np.ndarray, number: int = 0, closed: bool = False, sigma: float = 0.0) -> Chain:
    n = len(points)
    return Chain(number, closed, R, points, np.full(n, sigma), np.full(n, 8, dtype=np.int64), ("free", "free"))


def straight(y: float = 0.0, z: float = R, length: float = 0.2, degrees: float = 0.0, number: int = 0) -> Chain:
    """A string along x, turned about the origin, in its middle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x = np.linspace(-length / 2, length / 2, 51)
    return chain(np.column_stack([c * x - s * y, s * x + c * y, np.full(51, TABLE_Z + z)]), number)


def grasps_of(
    *chains: Chain,
    crossings: tuple[Crossing, ...] = (),
    surface: np.ndarray = NOTHING,
    gripper: Gripper = GRIPPER,
) -> tuple[tuple[Grasp, ...], list[str]]:
    return find_grasps(chains, crossings, surface, Scene(table_z_m=TABLE_Z), PARAMETERS, gripper)


@pytest.mark.parametrize("degrees", [0, 37, 180, -110])
def test_a_straight_string_is_taken_from_above_and_across(degrees: float) -> None:
    grasps, warnings = grasps_of(straight(degrees=degrees))
    assert warnings == []
    # Every 5 mm or so, but half a finger from the ends.
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
        assert grasp.clearance_m == FAR_M
    # The best is in the middle, and they come in order.
    assert min(grasps[0].s_m, 0.2 - grasps[0].s_m) > FAR_M
    scores = [grasp.score for grasp in grasps]
    assert scores == sorted(scores, reverse=True)
    assert 0 < scores[-1] < scores[0] <= 1


def test_every_frame_is_a_rigid_transform_on_the_centre_line() -> None:
    scene = make_scene("overhand-knot", 1)
    grasps, _ = grasps_of(*laid(scene.curves)[0], crossings=laid(scene.curves)[1])
    for grasp in grasps:
        T = grasp.T_base_grasp
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), rtol=0, atol=1e-9)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1, abs=1e-9)
        np.testing.assert_array_equal(T[3], (0, 0, 0, 1))
        # Chords of the 1 mm polyline.
        assert KDTree(scene.curves[0] + [0, 0, TABLE_Z]).query(T[:3, 3])[0] < 0.0006


def test_the_opening_grows_with_sigma_and_bend() -> None:
    unsure = replace(straight(), sigma_m=np.full(51, 0.001))
    grasps, _ = grasps_of(unsure)
    assert {round(grasp.opening_m, 9) for grasp in grasps} == {0.0164}  # 8.4 + 2 * 2 sigma + 4
    sure = grasps_of(straight())[0][0].score
    assert grasps[0].score == pytest.approx(sure / (1 + (2 / 4.2) ** 2), rel=1e-6)

    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    ring = chain(np.column_stack([0.03 * np.cos(t), 0.03 * np.sin(t), np.full(400, TABLE_Z + R)]), closed=True)
    grasps, _ = grasps_of(ring)
    # Half a finger along a circle of 30 mm, it is 5^2 / 60 mm off the tangent.
    bend = 0.03 * (1 - np.cos(HALF_FINGER / 0.03))
    np.testing.assert_allclose([grasp.opening_m for grasp in grasps], 0.0124 + 2 * bend, rtol=0, atol=2e-5)
    # All the way round: a closed chain has no end to keep away from.
    assert len(grasps) == int(ring.length_m / 0.005) + 1
    scores = [grasp.score for grasp in grasps]
    assert max(scores) - min(scores) < 0.01


def crossed(height: float, confidence: float = 1.0) -> tuple[Chain, Chain, Crossing]:
    """A string along x on the table, one along y over it at that height of its centre line, crossing in the middle."""
    under, over = straight(), straight(z=height, degrees=90, number=1)
    middle = np.array([0, 0, TABLE_Z + (height + R) / 2])
    return (
        under,
        over,
        Crossing(0, middle, StrandPoint(1, 0.1), StrandPoint(0, 0.1), height - R, np.pi / 2, 1, confidence),
    )


def test_none_near_a_crossing_on_the_strand_underneath() -> None:
    under, over, crossing = crossed(height=3 * R)
    grasps, _ = grasps_of(under, over, crossings=(crossing,))
    away = PARAMETERS.r_cn + HALF_FINGER
    below = np.abs([grasp.s_m - 0.1 for grasp in grasps if grasp.chain == 0])
    assert away <= below.min() < away + 0.005
    # The strand above can be taken there, as long as the fingertips stay above the one below by their clearance.
    above = [grasp for grasp in grasps if grasp.chain == 1 and abs(grasp.s_m - 0.1) < 0.004]
    assert above
    for grasp in above:
        tips = 3 * R - grasp.reach_m - 2 * R
        assert grasp.clearance_m == pytest.approx(tips, abs=2e-4)  # balls fill the string but for r / 30
        assert grasp.clearance_m >= GRIPPER.clearance_m
    best_away = max(grasp.score for grasp in grasps if grasp.chain == 1)
    assert max(grasp.score for grasp in above) < best_away / 2


def test_a_strand_pressed_into_the_one_below_is_not_taken_there() -> None:
    under, over, crossing = crossed(height=R + 0.6 * 2 * R)
    grasps, _ = grasps_of(under, over, crossings=(crossing,))
    assert min(abs(grasp.s_m - 0.1) for grasp in grasps if grasp.chain == 1) > R


def test_where_over_and_under_are_not_certain_neither_is_taken() -> None:
    under, over, crossing = crossed(height=3 * R, confidence=0.7)
    grasps, _ = grasps_of(under, over, crossings=(crossing,))
    away = PARAMETERS.r_cn + HALF_FINGER
    assert min(abs(grasp.s_m - 0.1) for grasp in grasps) >= away


def test_none_where_no_view_saw_the_string() -> None:
    seen = straight()
    views = seen.views.copy()
    views[25] = 0  # at 100 mm; its neighbours, 4 mm on, were seen
    grasps, _ = grasps_of(replace(seen, views=views))
    away = np.abs([grasp.s_m - 0.1 for grasp in grasps])
    assert HALF_FINGER < away.min() < HALF_FINGER + 0.009
    few = replace(seen, views=np.ones(51, dtype=np.int64))
    assert grasps_of(few)[0][0].score == pytest.approx(grasps_of(seen)[0][0].score / 3, rel=1e-6)


@pytest.mark.parametrize(("apart", "possible"), [(0.0085, False), (0.0145, False), (0.0175, True), (0.03, True)])
def test_strands_side_by_side_need_room_for_a_finger(apart: float, possible: bool) -> None:
    # A finger's outer face is 6.2 + 5 mm from the centre line, the other strand begins r before its own, and 1 mm is
    # kept: from 16.4 mm on there is room.
    grasps, warnings = grasps_of(straight(), straight(y=apart, number=1))
    assert bool(grasps) == possible
    if possible:
        outer = 0.0112 + R
        assert {round(grasp.clearance_m, 4) for grasp in grasps if abs(grasp.T_base_grasp[2, 2]) > 0.999} == {
            round(apart - outer, 4)
        }
    else:
        assert len(warnings) == 2
        assert "would touch" in warnings[0]


def box(x: float, y: float, size: float = 0.03, height: float = 0.03) -> np.ndarray:
    """Points of a box's top and the side towards the string, every millimetre."""
    a = np.arange(0, size + 1e-9, 0.001)
    u, v = (grid.ravel() for grid in np.meshgrid(a, a))
    top = np.column_stack([x + u, y + v, np.full(len(u), height)])
    side = np.column_stack([x + u, np.full(len(u), y), v * height / size])
    return np.vstack([top, side]) + np.array([0, 0, TABLE_Z])


def test_a_box_beside_the_string_takes_grasps_away() -> None:
    free, _ = grasps_of(straight())
    # 9 mm from the centre line: a finger of 5 mm does not fit between. It stands from 100 to 130 mm.
    grasps, _ = grasps_of(straight(), surface=box(0.0, 0.009))
    assert len(grasps) < len(free)
    s = np.array([grasp.s_m for grasp in grasps])
    assert not ((s > 0.1 - HALF_FINGER) & (s < 0.13 + HALF_FINGER)).any()
    assert (s < 0.1 - HALF_FINGER - 0.005).any()
    assert (s > 0.13 + HALF_FINGER + 0.005).any()
    # Farther away it only costs clearance: 25 mm less a finger's outer face; balls of voxels are up to 2.1 mm nearer.
    grasps, _ = grasps_of(straight(), surface=box(0.0, 0.025, height=0.02))
    assert len(grasps) == len(free)
    nearest = min(grasp.clearance_m for grasp in grasps if grasp.T_base_grasp[2, 2] < -0.999)
    assert 0.025 - 0.0112 - 0.0021 < nearest <= 0.025 - 0.0112


def test_high_things_are_in_the_palms_way() -> None:
    # 30 mm beside, where only the palm passes, 36.8 mm above the string's centre line.
    low, _ = grasps_of(straight(), surface=box(-0.1, 0.03, height=0.02))
    high, warnings = grasps_of(straight(length=0.06), surface=box(-0.015, 0.03, height=0.06))
    assert low
    assert high == ()
    assert "would touch" in warnings[0]


def test_a_stroke_smaller_than_the_string_is_said() -> None:
    grasps, warnings = grasps_of(straight(), gripper=Gripper(stroke_m=0.012))
    assert grasps == ()
    (warning,) = warnings
    assert "too wide" in warning
    assert "12.4 mm" in warning  # 8.4 + 4
    assert "opens 12.0 mm" in warning


def test_a_string_too_thin_for_fingers_above_the_table_is_said() -> None:
    thin = replace(straight(z=0.001), radius_m=0.001)
    grasps, warnings = grasps_of(thin)
    assert grasps == ()
    assert "touch the table" in warnings[0]
    grasps, _ = grasps_of(thin, gripper=Gripper(table_clearance_m=0.0005))
    assert {round(grasp.reach_m, 6) for grasp in grasps} == {0.0005}


def test_a_chain_shorter_than_a_finger_is_said() -> None:
    grasps, warnings = grasps_of(straight(length=0.009))
    assert grasps == ()
    assert "9 mm are no longer than a finger is wide" in warnings[0]


def test_no_string_no_grasp() -> None:
    assert grasps_of() == ((), [])
    assert grasps_of(surface=box(0, 0)) == ((), [])


def test_a_long_string_has_places_all_along() -> None:
    grasps, _ = grasps_of(straight(length=10.0))
    s = np.sort([grasp.s_m for grasp in grasps])
    assert len(s) == 100
    np.testing.assert_allclose(np.diff(s), (10 - 2 * HALF_FINGER) / 99, rtol=0, atol=1e-9)


def test_turning_the_chain_round_turns_the_grasps() -> None:
    (there, _), (back, _) = grasps_of(straight()), grasps_of(replace(straight(), points=straight().points[::-1].copy()))
    assert len(there) == len(back)
    by_place = {round(0.2 - grasp.s_m, 6): grasp for grasp in back}
    for grasp in there:
        other = by_place[round(grasp.s_m, 6)].T_base_grasp
        np.testing.assert_allclose(other[:, :2], -grasp.T_base_grasp[:, :2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(other[:, 2:], grasp.T_base_grasp[:, 2:], rtol=0, atol=1e-9)


def laid(curves: tuple[np.ndarray, ...]) -> tuple[tuple[Chain, ...], tuple[Crossing, ...]]:
    strands = [Strand(curve + np.array([0, 0, TABLE_Z]), np.zeros(len(curve), dtype=bool)) for curve in curves]
    crossings, _ = find_crossings(strands, NOTHING, PARAMETERS)
    return tuple(chain(strand.points, k) for k, strand in enumerate(strands)), tuple(crossings)


def finger_points(grasp: Grasp) -> np.ndarray:
    """Points in both fingers, base frame, less than 2 mm apart, from the tips to 30 mm before them."""
    inner = grasp.opening_m / 2
    x = np.concatenate([side * np.linspace(inner, inner + GRIPPER.finger_thickness_m, 4) for side in (-1, 1)])
    y = np.linspace(-HALF_FINGER, HALF_FINGER, 7)
    z = grasp.reach_m - np.linspace(0, 0.03, 17)
    grid = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid @ grasp.T_base_grasp[:3, :3].T + grasp.T_base_grasp[:3, 3]


@pytest.mark.parametrize("name", ["figure-eight", "overhand-knot", "coil", "several"])
def test_no_finger_is_in_a_string_or_the_table(name: str) -> None:
    curves = make_scene(name, 2).curves
    chains, crossings = laid(curves)
    grasps, _ = grasps_of(*chains, crossings=crossings)
    assert len(grasps) > 20
    tree = KDTree(np.vstack([c.points for c in chains]))
    for grasp in grasps:
        fingers = finger_points(grasp)
        # 0.2 mm: the curves are polylines of 1 mm, the balls fill a string but for r / 30.
        assert tree.query(fingers)[0].min() > R + GRIPPER.clearance_m - 2e-4
        assert fingers[:, 2].min() - TABLE_Z == pytest.approx(grasp.table_clearance_m, abs=1e-9)
        assert grasp.table_clearance_m > GRIPPER.table_clearance_m - 1e-9
    assert {grasp.chain for grasp in grasps} == {c.id for c in chains}


def test_a_strand_is_taken_tilted_where_straight_down_is_blocked() -> None:
    # Centre line at 20 mm, fingertips at 15.8; on the left, from 8.5 mm on, everything is 17 mm high.
    raised = straight(z=0.02)
    shelf = box(-0.11, 0.0085, size=0.22, height=0.017)
    grasps, _ = grasps_of(raised, surface=shelf)
    assert len(grasps) == len(grasps_of(raised)[0])
    for grasp in grasps:
        # Only leaning by 30 degrees, with the left finger up: its tip is then at 19.5 mm.
        np.testing.assert_allclose(grasp.T_base_grasp[2, :3], (0.5, 0, -np.sqrt(0.75)), rtol=0, atol=1e-9)
        # Less up to 2.1 mm for the balls of voxels.
        assert GRIPPER.clearance_m <= grasp.clearance_m < 0.0025
        fingers = finger_points(grasp)
        assert fingers[fingers[:, 1] > 0.0085][:, 2].min() > TABLE_Z + 0.019
    others, _ = grasps_of(raised, surface=shelf * np.array([1, -1, 1]))
    assert {round(grasp.T_base_grasp[2, 0], 9) for grasp in others} == {-0.5}


@st.composite
def odd_chains(draw: st.DrawFn) -> tuple[Chain, ...]:
    """Chains that wander about in space, stand still, rise or have a single point."""
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
                rng.uniform(0, 0.002, count), rng.integers(0, 9, count), ("free", "unseen"),
            )
        )  # fmt: skip
    return tuple(chains)


@settings(max_examples=50, deadline=None)
@given(odd_chains(), st.integers(0, 60), st.floats(0, 0.1))
def test_whatever_the_chains_grasps_are_possible_ones(chains: tuple[Chain, ...], count: int, spread: float) -> None:
    surface = np.random.default_rng(count).normal((0, 0, TABLE_Z), spread, (count, 3))
    crossings = tuple(
        Crossing(k, np.zeros(3), StrandPoint(a.id, a.length_m / 3), StrandPoint(b.id, b.length_m / 2), 0, 1, 1, 0.6)
        for k, (a, b) in enumerate(pairwise(chains))
    )
    grasps, warnings = grasps_of(*chains, crossings=crossings, surface=surface)
    assert len({grasp.chain for grasp in grasps}) + len(warnings) == len(chains)
    for grasp in grasps:
        T = grasp.T_base_grasp
        assert np.isfinite(T).all()
        np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), rtol=0, atol=1e-9)
        assert 0 <= grasp.s_m <= chains[grasp.chain].length_m
        assert 2 * chains[grasp.chain].radius_m < grasp.opening_m <= GRIPPER.stroke_m
        assert GRIPPER.clearance_m <= grasp.clearance_m <= FAR_M
        assert grasp.table_clearance_m >= GRIPPER.table_clearance_m - 1e-9
        assert 0 <= grasp.score <= 1


def test_the_document_holds_grasps_to_a_micrometre() -> None:
    grasps, _ = grasps_of(straight(degrees=33))
    document = PointChainModel("enhanced", PARAMETERS, (straight(degrees=33),), grasps=grasps).to_json()
    assert len(document["grasps"]) == len(grasps)
    told, grasp = document["grasps"][0], grasps[0]
    GraspDocument.model_validate(told)
    np.testing.assert_allclose(told["T_base_grasp"], grasp.T_base_grasp, rtol=0, atol=5e-7)
    # Rotations keep their figures, or the frame would not be rigid any more.
    rotation = np.array(told["T_base_grasp"])[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-8)
    assert told["s_m"] == pytest.approx(grasp.s_m, abs=5e-7)
    assert told["score"] == pytest.approx(grasp.score, abs=5e-5)
