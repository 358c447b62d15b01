import numpy as np
import pytest

from calibration.geometry.transforms import inverse, rigid, rotation_angle, transform_points
from cell.planning.look_at import ELEVATIONS_RAD, look_at
from cell.simulation.pose_errors import (
    NO_ERRORS,
    T_FLANGE_CAMERA,
    PoseErrors,
    perturbed,
    reported_flange_poses,
    viewpoints,
)
from cell.simulation.rendering.depth_camera import CAMERAS
from cell.simulation.scenes.scenes import make_scene


def test_the_camera_looks_at_its_target() -> None:
    target = np.array([0.1, -0.2, 0.05])
    T = rigid(look_at(target, 0.7, 0.9, 0.4, 0.5), "T")
    assert transform_points(inverse(T), target[None])[0] == pytest.approx([0, 0, 0.4], abs=1e-12)
    assert T[2, 3] - 0.05 == pytest.approx(0.4 * np.sin(0.9))


def test_without_roll_the_image_is_upright() -> None:
    T = look_at(np.zeros(3), 2.0, 0.9, 0.4, 0.0)
    assert T[2, 0] == pytest.approx(0.0, abs=1e-12)
    assert T[2, 1] < 0


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("scene", ["figure-eight", "straight"])
def test_every_viewpoint_sees_the_whole_string(name: str, scene: str) -> None:
    model = CAMERAS[name]
    points = make_scene(scene, 0, length_m=0.35).curves[0]
    poses = viewpoints(points, model.K, (model.width, model.height), model.near_m, model.working_m, 8)
    assert len(poses) == 8
    for T in poses:
        pixels = transform_points(inverse(T), points) @ model.K.T
        u, v = pixels[:, 0] / pixels[:, 2], pixels[:, 1] / pixels[:, 2]
        assert u.min() > 0
        assert u.max() < model.width - 1
        assert v.min() > 0
        assert v.max() < model.height - 1
        assert pixels[:, 2].min() > model.near_m
    elevation = [np.arcsin(T[2, 3] / np.linalg.norm(T[:3, 3])) for T in poses]
    assert elevation == pytest.approx(list(ELEVATIONS_RAD) * 4)
    distances = [np.linalg.norm(T[:3, 3]) for T in poses]
    assert distances == pytest.approx([distances[0]] * 8)
    assert model.working_m[0] <= distances[0] <= model.working_m[1]


def test_errors_have_the_configured_size() -> None:
    rng = np.random.default_rng(0)
    T = look_at(np.array([0.4, 0.1, 0.2]), 1.0, 1.0, 0.5, 0.3)
    reported = [perturbed(T, 0.0005, 0.002, rng) for _ in range(3000)]
    shift = np.sqrt(np.mean([((S[:3, 3] - T[:3, 3]) ** 2).sum() for S in reported]))
    turn = np.sqrt(np.mean([rotation_angle(S @ inverse(T)) ** 2 for S in reported]))
    # The root mean square of 3000 samples with three components is off by about 1 %.
    assert shift == pytest.approx(0.0005, rel=0.05)
    assert turn == pytest.approx(0.002, rel=0.05)


def test_without_errors_the_reported_poses_are_true() -> None:
    T_base_camera = [look_at(np.zeros(3), k, 1.0, 0.4, 0.1 * k) for k in range(4)]
    reported = reported_flange_poses(T_base_camera, T_FLANGE_CAMERA, NO_ERRORS, np.random.default_rng(0))
    for T_base_flange, T in zip(reported, T_base_camera, strict=True):
        assert T_base_flange @ T_FLANGE_CAMERA == pytest.approx(T, abs=1e-12)


def test_errors_scale() -> None:
    assert PoseErrors().scaled(0.0) == NO_ERRORS
    assert PoseErrors().scaled(2.0).robot_m == 0.001
