import itertools
from functools import cache

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, inverse, rotation_angle, transform_points
from calibration.target.board import Board
from cell.config.arm_config import SimulatedArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings, MountingSettings, WorkspaceSettings
from cell.errors import ViewpointsError
from cell.kinematics.collision import collision_model
from cell.kinematics.ur_kinematics import forward
from cell.planning.calibration_poses import (
    MAX_RATIO,
    MIN_RATIO,
    OFF_MIDDLE_M,
    plan_calibration,
    plan_verification,
)
from cell.planning.viewpoints import Viewpoint, ViewpointPlan
from cell.simulation.pose_errors import T_FLANGE_CAMERA

pytestmark = pytest.mark.slow

BOARD = Board()
DEFAULT = CellSettings()
FAR = CellSettings(workspace=WorkspaceSettings(x_m=(0.44, 0.8)))
"""Workspace so far away that the arm cannot reach the preferred poses behind the board."""
SMALL = CellSettings(
    arm=SimulatedArm(model="ur3e"),
    camera=SimulatedCamera(model="ideal-sr"),
    workspace=WorkspaceSettings(x_m=(0.15, 0.35), y_m=(-0.1, 0.1)),
)
CELLS = [DEFAULT, FAR, SMALL]


@cache
def planned(cell: int) -> ViewpointPlan:
    return plan_calibration(CELLS[cell], BOARD, T_FLANGE_CAMERA, None)


def middle_of(settings: CellSettings) -> np.ndarray:
    (x0, x1), (y0, y1), (floor, _) = settings.workspace_m
    return np.array([(x0 + x1) / 2, (y0 + y1) / 2, floor])


def reached(plan: ViewpointPlan) -> list[Viewpoint]:
    return [v for v in plan.viewpoints if v.q_rad is not None]


@pytest.mark.parametrize("cell", range(len(CELLS)))
def test_every_image_shows_the_whole_board_near_the_middle(cell: int) -> None:
    settings, plan = CELLS[cell], planned(cell)
    optics, rng = settings.camera.optics, np.random.default_rng(0)
    points = BOARD.points - BOARD.points.mean(axis=0)
    assert plan.reachable == 17
    for v, _ in itertools.product(reached(plan), range(20)):
        yaw, toward, off = rng.uniform(0, 2 * np.pi, 2).tolist() + [OFF_MIDDLE_M]
        c, s = np.cos(yaw), np.sin(yaw)
        place = middle_of(settings) + off * np.array([np.cos(toward), np.sin(toward), 0.0])
        lying = points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + place
        seen = transform_points(inverse(v.T_base_camera), lying)
        pixels = (seen @ optics.K.T)[:, :2] / seen[:, 2:]
        # The margin is a twentieth of the image, slightly less at poses that are 10 degrees too low.
        margin = 0.04 * np.array([optics.width, optics.height])
        assert (pixels > margin).all()
        assert (pixels < np.array([optics.width, optics.height]) - margin).all()


def test_a_measured_mounting_shows_most_of_the_board() -> None:
    optics, rng = DEFAULT.camera.optics, np.random.default_rng(0)
    corners = BOARD.points - BOARD.points.mean(axis=0) + middle_of(DEFAULT)
    turn, shift = rng.normal(size=(2, 3))
    error = from_rotation_vector(0.03 * shift / np.linalg.norm(shift), np.deg2rad(10) * turn / np.linalg.norm(turn))
    plan = plan_calibration(DEFAULT, BOARD, T_FLANGE_CAMERA @ error, None)
    for v in reached(plan):
        seen = transform_points(inverse(v.T_base_flange @ T_FLANGE_CAMERA), corners)
        pixels = (seen @ optics.K.T)[:, :2] / seen[:, 2:]
        inside = ((pixels > 0) & (pixels < (optics.width - 1, optics.height - 1))).all(axis=1)
        assert inside.mean() > 0.75


def test_the_poses_have_all_azimuths_several_rolls_and_two_distances() -> None:
    plan = planned(0)
    solved_from = plan.viewpoints[:15]
    assert plan.held_out == (15, 16)
    assert plan.warnings == ()
    assert [v.index for v in plan.viewpoints] == list(range(17))
    assert all(59.9 < np.rad2deg(v.elevation_rad) < 70.1 for v in plan.viewpoints)
    azimuths = np.sort([v.azimuth_rad for v in solved_from])
    assert np.diff(azimuths, append=azimuths[0] + 2 * np.pi).max() < np.deg2rad(30)
    distances = [v.distance_m for v in solved_from]
    near, far = min(distances), max(distances)
    assert MIN_RATIO <= far / near <= MAX_RATIO
    assert far <= DEFAULT.camera.optics.working_m[1] + 1e-9
    assert sum(distance > (near + far) / 2 for distance in distances) == 5
    preferred = {round(np.rad2deg(v.roll_rad)) for v in solved_from if v.fallback is None}
    assert preferred == {-75, -25, 25, 75}


@pytest.mark.parametrize("cell", range(len(CELLS)))
def test_held_out_poses_differ_from_the_other_poses(cell: int) -> None:
    plan = planned(cell)
    for held_out, other in itertools.product(plan.viewpoints[15:], plan.viewpoints[:15]):
        apart = inverse(held_out.T_base_camera) @ other.T_base_camera
        assert np.linalg.norm(apart[:3, 3]) > 0.03
        assert rotation_angle(apart) > np.deg2rad(5)


@pytest.mark.parametrize("cell", range(len(CELLS)))
def test_the_path_is_free_and_visits_each_pose_and_home(cell: int) -> None:
    settings, plan = CELLS[cell], planned(cell)
    collisions = collision_model(settings, T_FLANGE_CAMERA)
    place = plan.start_q_rad
    for leg in plan.legs:
        for target in leg.waypoints_rad:
            line = place + np.linspace(0, 1, 100)[:, None] * (target - place)
            # As for viewpoints, positions between the samples may be slightly nearer.
            assert (collisions.gaps(line) > collisions.clearances - 0.02).all()
            place = target
        if leg.view is None:
            assert np.array_equal(place, plan.home_q_rad)
        else:
            v = plan.viewpoints[leg.view]
            assert forward(settings.arm.model, place) == pytest.approx(v.T_base_flange, abs=2e-7)
    assert sorted(leg.view for leg in plan.legs if leg.view is not None) == [v.index for v in reached(plan)]


def test_the_number_of_poses_can_be_set() -> None:
    plan = plan_calibration(DEFAULT, BOARD, T_FLANGE_CAMERA, None, poses=12, held_out=0)
    assert (plan.reachable, plan.held_out, plan.warnings) == (12, (), ())


def test_another_pose_is_held_out_if_none_for_verification_is_reachable() -> None:
    far_off = CellSettings(workspace=WorkspaceSettings(x_m=(0.64, 1.0)))
    plan = plan_calibration(far_off, BOARD, T_FLANGE_CAMERA, None, held_out=1)
    assert plan.viewpoints[15].q_rad is None
    last = max(v.index for v in reached(plan))
    assert (plan.held_out, plan.warnings) == ((last, 15), ())
    assert plan.reachable - 1 >= 10


def test_without_a_held_out_pose_there_is_a_warning() -> None:
    farther_off = CellSettings(workspace=WorkspaceSettings(x_m=(0.67, 1.03)))
    plan = plan_calibration(farther_off, BOARD, T_FLANGE_CAMERA, None, held_out=1)
    assert plan.reachable == 10
    assert plan.held_out == (15,)
    assert "the calibration will not be verified: change x_m" in plan.warnings[0]


def test_too_few_reachable_poses_are_refused_with_reasons() -> None:
    out_of_reach = CellSettings(workspace=WorkspaceSettings(x_m=(0.72, 1.08)))
    with pytest.raises(
        ViewpointsError, match=r"only \d of 15 calibration poses can be reached, 10 are needed"
    ) as refused:
        plan_calibration(out_of_reach, BOARD, T_FLANGE_CAMERA, None)
    assert "0: out of the arm's reach" in str(refused.value).split("Not reached are ")[1]


def test_a_board_that_is_too_large_is_refused() -> None:
    board = Board(pitch_m=0.08, marker_m=0.056)
    with pytest.raises(
        ViewpointsError, match=r"take a smaller board, as the camera sees all of this one from 0\.\d\d m"
    ):
        plan_calibration(CellSettings(), board, T_FLANGE_CAMERA, None)


def test_unreachable_far_poses_give_a_warning() -> None:
    wide = CellSettings(camera=SimulatedCamera(working_m=(0.55, 1.0)))
    plan = plan_calibration(wide, BOARD, T_FLANGE_CAMERA, None)
    far = sum(v.distance_m > (0.55 + 0.55 * MAX_RATIO) / 2 for v in reached(plan) if v.index < 15)
    assert far < 3
    assert f"{far} far from it" in plan.warnings[0]


@pytest.mark.parametrize("settings", CELLS)
def test_a_verification_has_views_from_opposite_sides(settings: CellSettings) -> None:
    plan = plan_verification(settings, BOARD, T_FLANGE_CAMERA, None)
    one, other = (v.T_base_camera for v in plan.viewpoints)
    assert plan.held_out == (0, 1)
    sides = np.array([T[:2, 3] - middle_of(settings)[:2] for T in (one, other)])
    cosine = (sides[0] @ sides[1]) / np.prod(np.linalg.norm(sides, axis=1))
    assert cosine < np.cos(np.deg2rad(150))
    # A displacement of the camera along the table separates the two board positions by nearly twice its size.
    assert np.linalg.norm((one - other)[:2, 0]) > 1.5


def test_a_verification_from_one_side_is_refused() -> None:
    wall = MountingSettings(obstacles_m=(((-0.2, 0.14, 0.0), (0.9, 0.6, 0.9)),))
    settings = CellSettings(mounting=wall)
    with pytest.raises(ViewpointsError, match="from two sides of the board, and the arm does not reach both"):
        plan_verification(settings, BOARD, T_FLANGE_CAMERA, None)
