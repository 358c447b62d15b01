from dataclasses import replace

import numpy as np
import pytest

from cell.simulation.cases import make_case
from cell.simulation.grasp_physics.settings import PhysicsSettings, RobotError
from cell.simulation.grasp_physics.trial import PlannedGrasp, drift_at_rest, simulate_grasp
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.grasping.gripper import Gripper
from tests.cell.simulation.grasp_physics.scenes_and_grasps import (
    RADIUS_M,
    REACH_M,
    straight_scene,
    upright_grasp,
    upright_pose,
)

GRIPPER = Gripper()
FINGER_MIDDLE_M = 0.0124 / 2 + GRIPPER.finger_thickness_m / 2
"""Distance of the middle of an open finger from the grasp."""


def touched(outcome) -> set[tuple[str, str]]:
    return {(touch.by, touch.what) for touch in outcome.touches}


def test_a_grasp_on_a_straight_string_holds_and_touches_nothing_before() -> None:
    outcome = simulate_grasp(straight_scene(), upright_grasp(), GRIPPER)
    assert outcome.held
    assert outcome.good
    assert outcome.touches == ()
    # The string does not slip: it rises with the fingers.
    assert outcome.rise_m == pytest.approx(0.06, abs=0.001)
    # Half a segment is 3 mm.
    assert outcome.slip_m is not None
    assert outcome.slip_m <= 0.0031


def test_a_grasp_beside_the_string_holds_nothing() -> None:
    outcome = simulate_grasp(straight_scene(), upright_grasp(y_m=0.02), GRIPPER)
    assert not outcome.held
    assert not outcome.wrong_string
    assert outcome.rise_m == 0.0
    assert outcome.slip_m is None


@pytest.mark.parametrize(("raised_m", "held"), [(0.0015, True), (0.003, False)])
def test_a_grasp_slips_only_if_the_fingertips_are_above_the_middle_of_the_string(raised_m: float, held: bool) -> None:
    # The fingertips reach 2.2 mm beyond the middle.
    assert simulate_grasp(straight_scene(), upright_grasp(raised_m=raised_m), GRIPPER).held is held


def test_a_grasp_at_another_position_along_the_string_is_not_held() -> None:
    grasp = replace(upright_grasp(x_m=0.03), s_m=0.15)
    outcome = simulate_grasp(straight_scene(), grasp, GRIPPER)
    assert not outcome.held


def test_a_finger_that_comes_down_on_another_string_is_reported() -> None:
    outcome = simulate_grasp(straight_scene(FINGER_MIDDLE_M), upright_grasp(), GRIPPER)
    assert ("finger", "other strand") in touched(outcome)
    assert outcome.touches_more()
    deepest = max(touch.depth_m for touch in outcome.touches if touch.what == "other strand")
    assert 0.0005 < deepest < 2 * RADIUS_M
    assert all(touch.force_n > 0 for touch in outcome.touches)


def test_a_finger_that_comes_down_on_a_box_is_reported() -> None:
    box = Box((0.0, FINGER_MIDDLE_M + 0.0025), (0.02, 0.009, 0.0045), 0.0)
    outcome = simulate_grasp(straight_scene(boxes=(box,)), upright_grasp(), GRIPPER)
    assert touched(outcome) == {("finger", "object")}
    # The box reaches 2.5 mm above the fingertips. The robot does not stop.
    assert max(touch.depth_m for touch in outcome.touches) == pytest.approx(0.0025, abs=0.0001)


def test_a_palm_that_comes_down_on_a_box_is_reported() -> None:
    box = Box((0.025, 0.035), (0.01, 0.03, 0.06), 0.0)
    assert touched(simulate_grasp(straight_scene(boxes=(box,)), upright_grasp(), GRIPPER)) == {("palm", "object")}


def test_a_string_on_a_plate_is_held_unless_the_fingers_reach_the_plate() -> None:
    plate = Box((0.0, 0.0), (0.35, 0.06, 0.002), 0.0)
    flat = straight_scene(boxes=(plate,))
    scene = replace(flat, curves=(flat.curves[0] + (0.0, 0.0, 0.002),))
    assert drift_at_rest(scene, np.zeros(3)).max() < 0.0003
    high = simulate_grasp(scene, upright_grasp(raised_m=0.002), GRIPPER)
    assert high.good
    assert not high.touches_more()
    # A planner that does not see the plate keeps 1 mm from the table.
    low = simulate_grasp(scene, replace(upright_grasp(raised_m=0.002), reach_m=0.0052), GRIPPER)
    assert ("finger", "object") in touched(low)


def test_fingertips_on_the_table_are_reported() -> None:
    outcome = simulate_grasp(straight_scene(), upright_grasp(), GRIPPER, RobotError("down", down_m=0.003))
    assert touched(outcome) == {("finger", "table")}


def test_the_other_string_alone_is_the_wrong_string() -> None:
    scene = straight_scene(0.04)
    outcome = simulate_grasp(scene, upright_grasp(y_m=0.04), GRIPPER)
    assert outcome.wrong_string
    assert not outcome.held


def test_a_distant_part_of_the_same_string_is_the_wrong_string() -> None:
    first, second = straight_scene(0.04).curves
    angle = np.linspace(-np.pi / 2, np.pi / 2, 64)[1:-1]
    turn = np.column_stack([0.15 + 0.02 * np.cos(angle), 0.02 + 0.02 * np.sin(angle), np.full_like(angle, RADIUS_M)])
    scene = StringScene("hairpin", RADIUS_M, (np.vstack([first, turn, second[::-1]]),))
    outcome = simulate_grasp(scene, upright_grasp(y_m=0.04), GRIPPER)
    assert outcome.wrong_string
    assert not outcome.held
    assert simulate_grasp(scene, upright_grasp(), GRIPPER).good


def test_a_string_that_is_lifted_together_with_the_right_one_is_the_wrong_string() -> None:
    below = straight_scene()
    above = below.curves[0][100:201] + (0.0, 0.0, 2 * RADIUS_M)
    scene = replace(below, curves=(*below.curves, above), radii_m=())
    outcome = simulate_grasp(scene, upright_grasp(), GRIPPER)
    assert outcome.wrong_string
    assert outcome.held
    assert not outcome.good


def test_a_tilted_grasp_holds() -> None:
    tilt = np.deg2rad(15.0)
    c, s = np.cos(tilt), np.sin(tilt)
    T = upright_pose(0.0, 0.0, RADIUS_M + 0.001)
    T[:3, :3] = T[:3, :3] @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    outcome = simulate_grasp(straight_scene(), PlannedGrasp(0, 0.15, T, 0.0124, 0.001), GRIPPER)
    assert outcome.good
    assert outcome.rise_m == pytest.approx(0.06 * c, abs=0.002)  # the lift is back along the approach


def test_a_closed_string_is_held_wherever_it_begins() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 252)
    ring = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), np.full_like(angle, RADIUS_M)])
    ring[-1] = ring[0]
    scene = StringScene("ring", RADIUS_M, (ring,))
    assert scene.closed == (True,)
    # The closing direction is across the string at (0.04, 0), where the curve begins.
    T = upright_pose(0.04, 0.0, RADIUS_M)
    T[:3, :3] = np.column_stack([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)])
    outcome = simulate_grasp(scene, PlannedGrasp(0, 0.0, T, 0.0132, REACH_M), GRIPPER)
    assert outcome.good
    assert outcome.rise_m > 0.055


def test_half_the_time_step_gives_the_same_result() -> None:
    for raised_m in (0.0, 0.0045):
        whole, half = (
            simulate_grasp(
                straight_scene(),
                upright_grasp(raised_m=raised_m),
                GRIPPER,
                settings=PhysicsSettings(time_step_s=step_s),
            )
            for step_s in (0.002, 0.001)
        )
        assert whole.held is half.held
        assert whole.rise_m == pytest.approx(half.rise_m, abs=0.0005)


@pytest.mark.parametrize("tier", ["paper", "long", "many", "soft", "photo"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(1, 20))])
def test_strings_that_are_not_gripped_stay_where_they_lie(tier: str, seed: int) -> None:
    scene = make_case(tier, seed).scene
    curve = scene.curves[seed % len(scene.curves)]
    for share in (0.2, 0.5, 0.8):
        drift_m = drift_at_rest(scene, curve[int(share * len(curve))])
        assert len(drift_m) > 10
        # Strands at crossings settle by some tenths of a millimetre.
        assert drift_m.max() < 0.001
