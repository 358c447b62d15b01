"""The prior of the poses against drawn robot and hand-eye errors."""

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, inverse, transform_points
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.pose_prior import N_DISPARITY, N_SHARED, PoseSigmas, pose_prior, twist_about

CENTRE = np.array([0.05, -0.02, 0.005])
SIGMAS = PoseSigmas()


def ring(count: int) -> list[np.ndarray]:
    """Return T_base_camera of views around the centre, 0.4 m away and directed at it."""
    poses = []
    for k in range(count):
        R = from_rotation_vector(np.zeros(3), (0, 0, 2 * np.pi * k / count))
        look = from_rotation_vector((0.25, 0.0, 0.3), np.zeros(3)) @ from_rotation_vector((0, 0, 0), (0, -2.4, 0))
        poses.append(from_rotation_vector(CENTRE, np.zeros(3)) @ R @ look)
    return poses


def cloud_at(view: int, T_base_camera: np.ndarray | None, T_correction: np.ndarray | None = None) -> NormalCloud:
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9), [0.0]), axis=-1).reshape(-1, 3)
    points = CENTRE + grid
    T = np.eye(4) if T_correction is None else T_correction
    return NormalCloud(view, points, np.tile((0.0, 0.0, 1.0), (81, 1)), T, T_base_camera)


def drawn(rng: np.random.Generator, poses: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Draw the true corrections (V, 6) of the given poses, and the hand-eye error (6,) in the camera frame."""
    hand_eye = rng.standard_normal(6) * np.repeat([SIGMAS.hand_eye_rad, SIGMAS.hand_eye_m], 3)
    twists = []
    for T in poses:
        robot = rng.standard_normal(6) * np.repeat([SIGMAS.robot_rad, SIGMAS.robot_m], 3)
        E_robot = from_rotation_vector(robot[3:], robot[:3])
        at_camera = from_rotation_vector(T[:3, 3], np.zeros(3))
        truth = at_camera @ E_robot @ inverse(at_camera) @ T @ from_rotation_vector(hand_eye[3:], hand_eye[:3])
        twists.append(twist_about(truth @ inverse(T), CENTRE))
    return np.array(twists), hand_eye


def test_drawn_errors_spread_as_the_prior_predicts() -> None:
    poses = ring(5)
    prior = pose_prior([cloud_at(k, T) for k, T in enumerate(poses)], CENTRE, SIGMAS)
    # Without the disparity error, which was not drawn.
    only_poses = prior.information[:-N_DISPARITY, :-N_DISPARITY]
    covariance = np.linalg.inv(only_poses)[: 6 * 5, : 6 * 5]
    rng = np.random.default_rng(0)
    drawn_twists = np.array([drawn(rng, poses)[0].ravel() for _ in range(600)])
    squared = np.einsum("ki,ij,kj->k", drawn_twists, np.linalg.inv(covariance), drawn_twists) / 30
    # Chi square of 30 degrees of freedom over 30: a mean of 1 +- 0.011. Products of two errors are neglected.
    assert squared.mean() == pytest.approx(1.0, abs=0.04)
    # Shared errors rotate with the view: covariance of a view with the opposite one.
    sampled = np.cov(drawn_twists.T)
    np.testing.assert_allclose(sampled[3:6, 15:18], covariance[3:6, 15:18], rtol=0, atol=0.2 * covariance[3, 3])


def test_the_hand_eye_error_is_found_from_its_twists() -> None:
    poses = ring(8)
    clouds = [cloud_at(k, T) for k, T in enumerate(poses)]
    prior = pose_prior(clouds, CENTRE, SIGMAS)
    hand_eye = np.array([0.003, -0.001, 0.002, 0.0008, 0.0, -0.0005])
    twists = np.concatenate(
        [twist_about(T @ from_rotation_vector(hand_eye[3:], hand_eye[:3]) @ inverse(T), CENTRE) for T in poses]
    )
    information, gradient = prior.information.copy(), prior.gradient.copy()
    information[: len(twists), : len(twists)] += np.eye(len(twists)) * 1e14
    gradient[: len(twists)] -= twists * 1e14
    found = -np.linalg.solve(information, gradient)
    # Eight views at 1 mrad and 0.3 mm against a prior of 1.5 mrad and 0.4 mm: the prior keeps 1 part in 20. The
    # disparity offset may explain some of the shift along the line of sight.
    np.testing.assert_allclose(found[-9:-6], hand_eye[:3], rtol=0, atol=0.0003)
    np.testing.assert_allclose(found[-6:-4], hand_eye[3:5], rtol=0, atol=0.0002)


def test_table_alignment_informs_the_rest_of_the_pose() -> None:
    # The hand-eye rotation was wrong: the table was seen tilted and was aligned about its centre. The prior knows that
    # the same rotation has also shifted the view.
    poses = ring(8)
    turn = np.array([0.0025, 0.002, 0.0])
    clouds, twists = [], []
    for k, T in enumerate(poses):
        error = twist_about(T @ from_rotation_vector(np.zeros(3), turn) @ inverse(T), CENTRE)
        level = np.array([error[0], error[1], 0.0, 0.0, 0.0, error[5]])
        T_alignment = from_rotation_vector(level[3:], level[:3])
        T_alignment[:3, 3] += CENTRE - T_alignment[:3, :3] @ CENTRE
        clouds.append(cloud_at(k, T_alignment @ T, T_alignment))
        twists.append(error - level)
    prior = pose_prior(clouds, CENTRE, SIGMAS)
    found = -np.linalg.solve(prior.information, prior.gradient)[:-N_SHARED].reshape(-1, 6)
    left, before = np.array(twists) - found, np.array(twists)
    assert np.linalg.norm(left[:, 3:5], axis=1).mean() < 0.6 * np.linalg.norm(before[:, 3:5], axis=1).mean()
    # The directions that the table measured stay as they are.
    assert np.abs(found[:, [0, 1]]).max() < SIGMAS.table_rad
    assert np.abs(found[:, 5]).max() < SIGMAS.table_m


def test_without_cameras_errors_are_about_the_centre() -> None:
    prior = pose_prior([cloud_at(0, None), cloud_at(1, None)], CENTRE, SIGMAS)
    np.testing.assert_array_equal(prior.gradient, 0.0)
    difference = np.linalg.inv(prior.information)
    difference = difference[:6, :6] + difference[6:12, 6:12] - difference[:6, 6:12] - difference[6:12, :6]
    # The shared error cancels. Two robot errors remain.
    expected = 2 * np.diag(np.repeat([SIGMAS.robot_rad, SIGMAS.robot_m], 3) ** 2)
    np.testing.assert_allclose(difference, expected, rtol=0, atol=1e-12)


def test_the_disparity_offset_moves_points_along_the_line_of_sight() -> None:
    T = from_rotation_vector(CENTRE + np.array([0, 0, 0.5]), (np.pi, 0, 0))
    prior = pose_prior([cloud_at(0, T)], CENTRE, SIGMAS)
    # Measured depths are too large by b times their square: the plane at 0.5 m is 0.25 b too low and must be raised.
    (D, _) = prior.robot_errors[0]
    to_camera = D[:, :6] * np.repeat([SIGMAS.robot_rad, SIGMAS.robot_m], 3)[:, None]
    twist = -np.linalg.solve(to_camera, D[:, -N_DISPARITY] * np.repeat([SIGMAS.robot_rad, SIGMAS.robot_m], 3))
    np.testing.assert_allclose(twist[5], 0.25, rtol=1e-6)
    np.testing.assert_allclose(twist[[0, 1, 2, 3, 4]], 0.0, rtol=0, atol=1e-9)


def test_a_disparity_slope_tilts_what_the_camera_sees() -> None:
    T = from_rotation_vector(CENTRE + np.array([0, 0, 0.5]), (np.pi, 0, 0))
    prior = pose_prior([cloud_at(0, T)], CENTRE, SIGMAS)
    (D, _) = prior.robot_errors[0]
    sigma = np.repeat([SIGMAS.robot_rad, SIGMAS.robot_m], 3)
    twists = -np.linalg.solve(D[:, :6] * sigma[:, None], D[:, -2:] * sigma[:, None])
    # A unit slope moves a point at the depth z beside the axis by x z: the plane tilts by z. The camera is turned, so
    # its columns run along x of the base frame and its rows against y.
    np.testing.assert_allclose(np.abs(twists[:2, 0]), [0.0, 0.5], rtol=0, atol=0.02)
    np.testing.assert_allclose(np.abs(twists[:2, 1]), [0.5, 0.0], rtol=0, atol=0.02)
    np.testing.assert_allclose(twists[2], 0.0, rtol=0, atol=1e-9)


def test_a_disparity_slope_is_no_hand_eye_error() -> None:
    """A tilt of the table in the same direction of every image is the slope of a matched camera, not its mounting."""
    matched = PoseSigmas.for_disparities(1 / 30.0)
    assert matched.disparity_per_m == pytest.approx(0.1 / 30)
    poses = ring(8)
    tilt = 0.15 / 30 * 0.39  # one sigma of the slope along the columns, at the distance of the views
    clouds = []
    for k, T in enumerate(poses):
        T_alignment = from_rotation_vector(np.zeros(3), tilt * T[:3, 1])
        T_alignment[:3, 3] += CENTRE - T_alignment[:3, :3] @ CENTRE
        clouds.append(cloud_at(k, T_alignment @ T, T_alignment))

    def hand_eye_sigma(sigmas: PoseSigmas) -> float:
        prior = pose_prior(clouds, CENTRE, sigmas)
        found = -np.linalg.solve(prior.information, prior.gradient)[-N_SHARED:-N_DISPARITY]
        return float(np.linalg.norm(found / np.repeat([sigmas.hand_eye_rad, sigmas.hand_eye_m], 3)))

    assert hand_eye_sigma(matched) < 0.7 * hand_eye_sigma(PoseSigmas())


def test_cameras_with_fine_disparities_keep_the_default_sigmas() -> None:
    assert PoseSigmas.for_disparities(None) == PoseSigmas()
    assert PoseSigmas.for_disparities(1e-6) == PoseSigmas()


def test_twist_about_returns_rotation_and_displacement() -> None:
    T = from_rotation_vector((0.1, 0.2, 0.3), (0.01, -0.02, 0.03))
    twist = twist_about(T, CENTRE)
    np.testing.assert_allclose(CENTRE + twist[3:], transform_points(T, CENTRE[None])[0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(twist[:3], (0.01, -0.02, 0.03), rtol=0, atol=1e-15)
