"""Reach of grasps: joint angles and straight descents, reasons, and the virtual controller."""

import itertools
from collections import Counter
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from cell.config.cell_config import CellSettings, MountingSettings
from cell.kinematics.ik_branches import MIN_SINGULAR_VALUE, USED_LIMIT_RAD
from cell.kinematics.ur_kinematics import forward, inverse, jacobian
from cell.planning.grasp_reach import GraspReach, find_reach, reach_model
from cell.planning.home import home_posture
from cell.simulation.cases import make_case, simulate
from cell.simulation.pose_errors import T_FLANGE_CAMERA
from cell.simulation.ur_controller.launcher import RunningController, start_controller
from cell.simulation.ur_controller.robot.poses import pose_matrix, pose_vector
from recognition.grasping.flange_poses import FlangePoses, flange_poses
from recognition.grasping.gripper import Gripper
from recognition.pipeline import recognise
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest
from tests.cell.loopback import free_host
from tests.cell.simulation.ur_controller import wheel
from tests.cell.simulation.ur_controller.wheel import CONNECT

DEFAULT = CellSettings()
GRIPPER = Gripper()
OPENING_M, REACH_M, R_M = 0.0125, 0.0032, 0.0042
HOME = home_posture(DEFAULT, T_FLANGE_CAMERA)

Matrix = NDArray[np.float64]


def grasp_at(x: float, y: float, closing_rad: float = 0.0, tilt_rad: float = 0.0, table_z_m: float = 0.0) -> Matrix:
    """Return a grasp of a string on the table, from above or tilted about the string."""
    c, s = np.cos(closing_rad), np.sin(closing_rad)
    T = np.array([(c, s, 0, x), (s, -c, 0, y), (0, 0, -1, table_z_m + R_M), (0, 0, 0, 1)])
    return T @ from_rotation_vector((0, 0, 0), (0, tilt_rad, 0))


def over_the_workspace(columns: int = 4) -> Matrix:
    (x0, x1), (y0, y1), _ = DEFAULT.workspace_m
    places = itertools.product(np.linspace(x0, x1, columns), np.linspace(y0, y1, columns), np.arange(4) * np.pi / 4)
    return np.array([grasp_at(*place) for place in places])


def reach_of(
    T: Matrix,
    settings: CellSettings = DEFAULT,
    gripper: Gripper = GRIPPER,
    reference: Matrix = HOME,
    table_points: Matrix | None = None,
) -> tuple[FlangePoses, tuple[GraspReach, ...]]:
    poses = flange_poses(T, np.full(len(T), REACH_M), gripper)
    model = reach_model(settings, T_FLANGE_CAMERA, gripper, reference, table_points)
    return poses, find_reach(model, poses, np.full(len(T), OPENING_M))


def assert_carried_out(poses: FlangePoses, index: int, reach: GraspReach, settings: CellSettings = DEFAULT) -> None:
    """Check everything that is promised of a reachable grasp, at finer steps than the search."""
    assert reach.q_pregrasp_rad is not None
    assert reach.q_grasp_rad is not None
    wanted = poses.turned() if reach.turned else poses
    arm = settings.arm.model
    # the tolerance of the descent is 1e-7
    np.testing.assert_allclose(forward(arm, reach.q_pregrasp_rad), wanted.pregrasp[index], rtol=0, atol=5e-7)
    np.testing.assert_allclose(forward(arm, reach.q_grasp_rad), wanted.grasp[index], rtol=0, atol=5e-7)
    assert np.abs([reach.q_pregrasp_rad, reach.q_grasp_rad]).max() <= USED_LIMIT_RAD
    # the straight line, solved again at every 2.5 mm: one solution goes on from the pre-grasp to the grasp
    q, line = reach.q_pregrasp_rad, []
    for share in np.linspace(0, 1, 21):
        T = wanted.pregrasp[index].copy()
        T[:3, 3] += share * (wanted.grasp[index, :3, 3] - T[:3, 3])
        solutions = q + np.remainder(inverse(arm, T) - q + np.pi, 2 * np.pi) - np.pi
        q = solutions[np.abs(solutions - q).max(axis=1).argmin()]
        line.append(q)
    steps = np.abs(np.diff(line, axis=0)).max(axis=1)
    assert steps.max() < 0.08
    np.testing.assert_allclose(q, reach.q_grasp_rad, rtol=0, atol=1e-5)
    values = np.linalg.svd(jacobian(arm, np.array(line)), compute_uv=False)[:, -1]
    # sampled at other points
    assert values.min() == pytest.approx(reach.min_singular_value, abs=1e-3)
    assert values.min() >= MIN_SINGULAR_VALUE
    collisions = reach_model(settings, T_FLANGE_CAMERA, GRIPPER, HOME).collisions
    short = collisions.clearances - collisions.gaps(np.array(line), np.full(len(line), OPENING_M))
    assert short.max() < 1e-4


def test_grasps_over_the_workspace_are_reached_in_one_branch() -> None:
    T = over_the_workspace()
    poses, found = reach_of(T)
    reached = [index for index, reach in enumerate(found) if reach.reachable]
    # some at the corners beside the base are too near the shoulder
    assert len(reached) >= 0.85 * len(T)
    for index in reached[::4]:
        assert_carried_out(poses, index, found[index])
    near_base = [reach for reach, grasp in zip(found, T, strict=True) if not reach.reachable and grasp[0, 3] > 0.31]
    assert near_base == []
    assert {reach.reason for reach in found if not reach.reachable} <= {"collision-gripper", "collision-arm"}


def test_a_tilted_grasp_is_reached_with_the_fingers_above_the_table() -> None:
    """A tilted, fully open gripper would reach into the table. The opening of the grasp counts."""
    T = np.array([grasp_at(0.4, 0.1, 0.3, sign * np.deg2rad(30)) for sign in (-1, 1)])
    T[:, 2, 3] += 0.005
    poses, found = reach_of(T)
    for index, reach in enumerate(found):
        assert reach.reachable
        assert_carried_out(poses, index, reach)
    model = reach_model(DEFAULT, T_FLANGE_CAMERA, GRIPPER, HOME)
    open_wide = find_reach(model, poses, np.full(2, 0.085))
    assert [reach.message for reach in open_wide] == ["the gripper's finger comes too near the table"] * 2


def test_with_a_short_gripper_the_camera_meets_the_table() -> None:
    _, found = reach_of(over_the_workspace(), gripper=Gripper(length_m=0.1))
    assert not any(reach.reachable for reach in found)
    messages = Counter(reach.message for reach in found)
    assert messages.most_common(1)[0][0] == "the camera comes too near the table"
    assert messages["the camera comes too near the table"] >= 0.8 * len(found)
    assert all(reach.reason == "collision-camera" for reach in found if reach.message and "camera" in reach.message)


@pytest.mark.parametrize(
    ("T", "settings", "reason", "message"),
    [
        (grasp_at(1.2, 0.0), DEFAULT, "out-of-reach", "out of the arm's reach"),
        (grasp_at(0.0, 0.05), DEFAULT, "out-of-reach", "too near the axis of the arm's base"),
        # the arm is nearly stretched: 0.90 m is reached, 0.91 m is out of reach
        (grasp_at(0.905, 0.0), DEFAULT, "singular", "near a singular posture"),
        (
            grasp_at(0.4, 0.0),
            CellSettings(mounting=MountingSettings(obstacles_m=(((0.3, -0.1, 0.0), (0.5, 0.1, 0.1)),))),
            "collision-gripper",
            "comes too near obstacle 1",
        ),
        (
            grasp_at(0.4, 0.0),
            CellSettings(mounting=MountingSettings(obstacles_m=(((-0.5, -1.0, 0.35), (0.8, 1.0, 0.4)),))),
            "collision-arm",
            "comes too near obstacle 1",
        ),
    ],
)
def test_the_reason_is_named(T: Matrix, settings: CellSettings, reason: str, message: str) -> None:
    _, (reach,) = reach_of(T[None], settings)
    assert not reach.reachable
    assert reach.q_grasp_rad is None
    assert reach.reason == reason, reach
    assert message in (reach.message or "")


def test_the_turn_that_keeps_the_camera_free_is_taken() -> None:
    T = grasp_at(0.4, 0.0)[None]
    _, (free,) = reach_of(T)
    assert free.q_grasp_rad is not None
    eye = (forward("ur5e", free.q_grasp_rad) @ T_FLANGE_CAMERA)[:3, 3]
    # a post where the camera would be
    post = eye + np.linspace(-0.1, 0.0, 20)[:, None] * (0, 0, 1)
    poses, (other,) = reach_of(T, table_points=post)
    assert other.reachable
    assert_carried_out(poses, 0, other)
    assert other.turned != free.turned
    # a ring of posts around the grasp blocks both turns
    turns = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    radius = np.linalg.norm(eye[:2] - (0.4, 0.0))
    ring = np.column_stack([0.4 + radius * np.cos(turns), radius * np.sin(turns), np.full(60, eye[2])])
    _, (none,) = reach_of(T, table_points=ring)
    assert (none.reason, none.message) == ("collision-camera", "the camera comes too near what lies on the table")


def test_the_posture_nearest_to_the_reference_is_taken() -> None:
    T = grasp_at(0.4, 0.0)[None]
    _, (from_home,) = reach_of(T)
    assert from_home.q_pregrasp_rad is not None
    # turned by a full turn of the last joint, within its limits
    start = from_home.q_pregrasp_rad + (0, 0, 0, 0, 0, -np.sign(from_home.q_pregrasp_rad[5]) * 2 * np.pi)
    _, (there,) = reach_of(T, reference=start)
    assert there.q_pregrasp_rad is not None
    np.testing.assert_allclose(there.q_pregrasp_rad, start, rtol=0, atol=1e-6)
    assert there.path_free


def test_a_blocked_path_is_reported() -> None:
    """The arm stands behind a wall, which a straight line in joint space crosses."""
    settings = CellSettings(mounting=MountingSettings(obstacles_m=(((-0.9, -0.06, 0.0), (-0.2, 0.02, 0.9)),)))
    T = np.array([grasp_at(-0.4, 0.45)])
    free, blocked = (
        reach_of(T, settings, reference=HOME + (first, 0, 0, 0, 0, 0))[1][0] for first in (-np.pi / 2, np.pi / 2)
    )
    assert free.reachable
    assert blocked.reachable
    assert (free.path_free, blocked.path_free) == (True, False)


def test_no_grasps_give_no_result() -> None:
    assert reach_of(np.zeros((0, 4, 4)))[1] == ()


CARRY_OUT = (
    CONNECT
    + """
reached = []
for q_pregrasp, pose, q_grasp in arguments["grasps"]:
    assert control.moveJ(q_pregrasp, 3.0, 10.0); time.sleep(0.02)
    pregrasp = receive.getActualTCPPose()
    assert control.moveL(pose, 1.0, 4.0); time.sleep(0.02)
    q_line, by_line = receive.getActualQ(), receive.getActualTCPPose()
    assert control.moveJ(q_grasp, 3.0, 10.0); time.sleep(0.02)
    reached.append([pregrasp, by_line, receive.getActualTCPPose(), q_line])
answer(reached=reached)
"""
)
"""Move to the pre-grasp, straight down to the pose of the grasp, and to its joint angles."""


@pytest.fixture(scope="module")
def controller() -> Iterator[RunningController]:
    """Yield a virtual controller that moves faster than real time."""
    with start_controller(host=free_host(), time_factor=20.0, q_rad=HOME) as controller:
        yield controller


def assert_the_controller_agrees(
    controller: RunningController, poses: FlangePoses, found: dict[int, GraspReach]
) -> None:
    """Carry out grasps by number, and compare what the controller reports. Its own solver finds the straight line."""
    wanted = [(poses.turned() if reach.turned else poses, index) for index, reach in found.items()]
    grasps = [
        (reach.q_pregrasp_rad, pose_vector(of.grasp[index]), reach.q_grasp_rad)
        for (of, index), reach in zip(wanted, found.values(), strict=True)
    ]
    as_lists = [[np.asarray(part).tolist() for part in grasp] for grasp in grasps]
    controller.admin.reset(HOME)
    answer = wheel.run(controller.host, CARRY_OUT, grasps=as_lists)
    for (of, index), reach, (*reported, q_line) in zip(wanted, found.values(), answer["reached"], strict=True):
        for pose, T in zip(reported, (of.pregrasp, of.grasp, of.grasp), strict=True):
            T_base_flange = pose_matrix(pose)
            # 0.1 mm, and 0.2 mrad, which is 0.03 mm at the fingertips
            assert np.linalg.norm(T_base_flange[:3, 3] - T[index, :3, 3]) < 1e-4
            np.testing.assert_allclose(T_base_flange[:3, :3], T[index, :3, :3], rtol=0, atol=2e-4)
        # the straight line ends in the branch that was given: 0.1 mrad moves the flange by 0.1 mm
        assert reach.q_grasp_rad is not None
        np.testing.assert_allclose(q_line, reach.q_grasp_rad, rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.xdist_group("cell")
def test_the_controller_carries_out_the_grasps(controller: RunningController) -> None:
    T = np.array([grasp_at(0.3, 0.1, 0.4), grasp_at(0.5, -0.15, 1.9), grasp_at(0.4, 0.0, 2.5, np.deg2rad(15))])
    T[2, 2, 3] += 0.004
    poses, found = reach_of(T)
    assert all(reach.reachable for reach in found)
    assert_the_controller_agrees(controller, poses, dict(enumerate(found)))


@pytest.mark.soak
@pytest.mark.xdist_group("cell")
@pytest.mark.parametrize("tier", ["paper", "long", "many", "physical"])
@pytest.mark.parametrize("seed", range(3))
def test_the_controller_carries_out_all_grasps_of_a_scene(controller: RunningController, tier: str, seed: int) -> None:
    """Recognise a scene, lay it into the default cell, and carry out each grasp that is reachable."""
    scan = simulate(make_case(tier, seed, "ideal"))
    grasps = recognise(
        scan.views, RecognitionRequest(radius_m=scan.header.string_radius_m or R_M), Scene(0.0, scan.header.workspace_m)
    ).model.grasps
    (x0, x1), (y0, y1), _ = DEFAULT.workspace_m
    T = np.array([grasp.T_base_grasp for grasp in grasps])
    T[:, :2, 3] += ((x0 + x1) / 2, (y0 + y1) / 2)
    poses = flange_poses(T, np.array([grasp.reach_m for grasp in grasps]), GRIPPER)
    model = reach_model(DEFAULT, T_FLANGE_CAMERA, GRIPPER, HOME)
    found = find_reach(model, poses, np.array([grasp.opening_m for grasp in grasps]))
    reached = [index for index, reach in enumerate(found) if reach.reachable]
    assert len(reached) >= 0.9 * len(grasps)
    for first in range(0, len(reached), 10):
        assert_the_controller_agrees(controller, poses, {k: found[k] for k in reached[first : first + 10]})
