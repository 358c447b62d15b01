from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.geometry.transforms import inverse, rigid, rotation_angle, transform_points
from calibration.target.board import Board
from cell.config.arm_config import URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings, HandEyeSettings, MountingSettings, WorkspaceSettings
from cell.errors import CellSettingsError
from cell.planning.look_at import look_at
from cell.simulation.devices.world import simulated_world, world_truth
from cell.simulation.evaluation.metrics import score
from cell.simulation.offline_scan import simulate
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.ground_truth import scene_truth
from cell.simulation.scenes.scenes import make_scene

CENTRE = np.array([0.5, 0.2, -0.1])


def settings(**camera: Any) -> CellSettings:
    return CellSettings(
        camera=SimulatedCamera(**camera),
        workspace=WorkspaceSettings(x_m=(0.2, 0.8), y_m=(-0.1, 0.5)),
        mounting=MountingSettings(table_z_m=-0.1),
    )


def model_of(truth: dict[str, Any]) -> dict[str, Any]:
    """Return the truth as a model document."""
    return {
        "chains": [{"id": k, "closed": False, "points": curve} for k, curve in enumerate(truth["curves"])],
        "crossings": [
            {
                "point": crossing["point"],
                "over": {"chain": crossing["over"][0], "s_m": crossing["over"][1]},
                "under": {"chain": crossing["under"][0], "s_m": crossing["under"][1]},
                "confidence": 1.0,
            }
            for crossing in truth["crossings"]
        ],
    }


def test_the_truth_is_in_the_base_frame_in_the_middle_of_the_workspace() -> None:
    world = simulated_world(settings(scene="overhand-knot", seed=1))
    truth, of_scene = world_truth(world), scene_truth(world.scene, [], world.T_flange_camera)
    assert world.T_base_scene[:3, 3] == pytest.approx(CENTRE)
    curve, original = np.array(truth["curves"][0]), np.array(of_scene["curves"][0])
    # The truth is rounded to 0.1 um.
    assert np.abs(curve - original - CENTRE).max() < 2e-7
    assert len(truth["crossings"]) == 3
    for moved, crossing in zip(truth["crossings"], of_scene["crossings"], strict=True):
        assert np.array(moved["point"]) == pytest.approx(np.array(crossing["point"]) + CENTRE, abs=2e-7)
        assert (moved["over"], moved["under"]) == (crossing["over"], crossing["under"])


def test_score_accepts_the_truth_of_the_world() -> None:
    world = simulated_world(settings(scene="several", seed=2))
    truth = world_truth(world)
    right = score(model_of(truth), truth)
    assert right.topology
    assert right.mean_m == pytest.approx(0.0, abs=1e-6)
    elsewhere = score(model_of(scene_truth(world.scene, [], world.T_flange_camera)), truth)
    assert not elsewhere.topology


def test_without_errors_the_camera_is_at_its_nominal_pose() -> None:
    world = simulated_world(settings(errors=0.0))
    T_base_flange = look_at(np.array([0.4, 0.0, 0.3]), 0.3, 1.0, 0.2, 0.4)
    assert np.array_equal(world.nominal_T_flange_camera, world.T_flange_camera)
    assert world.T_base_camera(T_base_flange) == pytest.approx(T_base_flange @ world.T_flange_camera, abs=1e-15)
    T_scene_camera = world.T_scene_camera(T_base_flange)
    assert world.T_base_scene @ T_scene_camera == pytest.approx(T_base_flange @ world.T_flange_camera, abs=1e-12)


def test_pose_errors_depend_on_the_pose_and_have_the_configured_size() -> None:
    world = simulated_world(settings(errors=2.0))
    shifts, turns = [], []
    for k in range(400):
        T_base_flange = look_at(np.array([0.4, 0.0, 0.3]), 0.01 * k, 1.0, 0.2, 0.0)
        true = world.T_base_camera(T_base_flange) @ inverse(world.T_flange_camera)
        again = world.T_base_camera(T_base_flange) @ inverse(world.T_flange_camera)
        assert np.array_equal(true, again)
        shifts.append(np.linalg.norm(true[:3, 3] - T_base_flange[:3, 3]))
        turns.append(rotation_angle(true @ inverse(T_base_flange)))
    # The root mean square of 400 samples with three components has a standard error of 2 %. The limit is three times.
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(2 * PoseErrors().robot_m, rel=0.06)
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(2 * PoseErrors().robot_rad, rel=0.06)
    assert len(np.unique(shifts)) == 400


def test_reported_poses_that_differ_slightly_have_the_same_error() -> None:
    world = simulated_world(settings())
    T_base_flange = look_at(np.array([0.4, 0.0, 0.3]), 0.3, 1.0, 0.2, 0.4)
    nearly = T_base_flange.copy()
    nearly[:3] = np.rint(nearly[:3] / 1e-5) * 1e-5
    shifted = nearly.copy()
    shifted[0, 3] += 3e-6  # less than half a step
    difference = world.T_base_camera(shifted)[:3, 3] - world.T_base_camera(nearly)[:3, 3]
    assert difference == pytest.approx([3e-6, 0, 0], abs=1e-12)


def test_the_same_seed_gives_the_calibration_and_bias_of_a_simulated_recording() -> None:
    world = simulated_world(settings(model="ideal", scene="straight", seed=7))
    recorded = simulate(make_scene("straight", 7), camera_model("ideal", (64, 40)), 7, views=1)
    assert np.array_equal(world.nominal_T_flange_camera, recorded.header.T_flange_camera)
    off_m = np.linalg.norm(world.nominal_T_flange_camera[:3, 3] - world.T_flange_camera[:3, 3])
    assert 0.0 < off_m < 4 * PoseErrors().hand_eye_m
    other = simulated_world(settings(model="ideal", scene="straight", seed=8))
    assert other.bias_px != world.bias_px
    assert abs(world.bias_px) < 4 * 0.1
    assert simulated_world(settings(model="exact", scene="straight", seed=7)).bias_px == 0.0


def test_the_nominal_hand_eye_calibration_has_the_id_of_its_camera() -> None:
    world, other = (simulated_world(settings(scene="straight", seed=seed)) for seed in (1, 2))
    assert world.nominal_hand_eye.camera_id == world.camera_id
    assert np.array_equal(world.nominal_hand_eye.T_flange_camera, world.nominal_T_flange_camera)
    assert world.nominal_hand_eye.sha256 == simulated_world(settings(scene="straight", seed=1)).nominal_hand_eye.sha256
    assert world.nominal_hand_eye.sha256 != other.nominal_hand_eye.sha256


def test_impossible_worlds_are_rejected() -> None:
    with pytest.raises(CellSettingsError, match=r"camera\.scene: overhand-knot: .*use a longer or a thinner one"):
        simulated_world(settings(scene="overhand-knot", string_radius_m=0.02))
    real = CellSettings(
        arm=URArm(kind="ur", host="10.0.0.9"),
        camera=OakCamera(kind="oak"),
        hand_eye=HandEyeSettings(file=Path("h.json")),
    )
    with pytest.raises(CellSettingsError, match=r"camera\.kind is oak"):
        simulated_world(real)


def test_the_settings_have_the_id_of_the_simulated_camera() -> None:
    for camera in (settings(), settings(model="exact", seed=5)):
        assert camera.camera_id == simulated_world(camera).camera_id


def test_a_board_replaces_the_strings_of_the_same_cell() -> None:
    world = simulated_world(settings(scene="overhand-knot", seed=1))
    laid = world.with_board(Board())
    assert (world.board, world.T_base_board) == (None, None)
    assert laid.board == Board()
    assert laid.scene.curves == ()
    assert (laid.camera_id, laid.bias_px, laid.errors) == (world.camera_id, world.bias_px, world.errors)
    assert laid.nominal_hand_eye.sha256 == world.nominal_hand_eye.sha256
    T_base_flange = look_at(np.array([0.4, 0.0, 0.3]), 0.3, 1.0, 0.2, 0.4)
    assert np.array_equal(laid.T_base_camera(T_base_flange), world.T_base_camera(T_base_flange))
    assert np.array_equal(laid.T_flange_camera, world.T_flange_camera)
    truth = world_truth(laid, [T_base_flange])
    assert (truth["curves"], truth["crossings"]) == ([], [])


@pytest.mark.parametrize("board", [Board(), Board("circles", 8, 6), Board("checkerboard", 6, 5, 0.02)])
def test_the_board_lies_flat_near_the_middle_with_its_print_up(board: Board) -> None:
    poses = []
    for seed in range(20):
        laid = simulated_world(settings(scene="straight", seed=seed)).with_board(board)
        assert laid.T_base_board is not None
        T = rigid(laid.T_base_board, "T_base_board")
        # z points into the table, because x points right and y points down when seen from above.
        assert T[:3, 2] == pytest.approx([0, 0, -1], abs=1e-15)
        middle = transform_points(T, board.points).mean(axis=0)
        assert middle[2] == pytest.approx(CENTRE[2] + 0.003)
        assert np.abs(middle[:2] - CENTRE[:2]).max() <= 0.03
        (plate,) = laid.scene.boxes
        assert np.array(plate.centre_m) == pytest.approx(middle[:2] - CENTRE[:2])
        assert plate.size_m == pytest.approx([*(np.array(board.size_m) + 2 * board.pitch_m), 0.003])
        again = simulated_world(settings(scene="straight", seed=seed)).with_board(board).T_base_board
        assert again is not None
        assert np.array_equal(again, T)
        poses.append(T)
    yaws = np.arctan2(*np.array(poses)[:, [1, 0], 0].T)
    # The angle is uniform from -40 to 40 degrees, and differs for each seed.
    assert np.abs(yaws).max() <= np.deg2rad(40)
    assert np.ptp(yaws) > np.deg2rad(40)
