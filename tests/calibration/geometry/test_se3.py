"""Stacks of transforms, checked against matrix products and finite differences."""

import numpy as np
import pytest

from calibration.geometry.se3 import (
    adjoint,
    cross_matrix,
    invert_poses,
    mean_pose,
    nearest_rotation,
    pose_from_twist,
    right_jacobian,
    rotation_angles,
    twist_from_pose,
)
from calibration.geometry.transforms import rotation_angle


@pytest.fixture
def poses() -> np.ndarray:
    """Return transforms (5, 4, 4) with rotations of up to about two radians."""
    return pose_from_twist(np.random.default_rng(0).normal(0, 0.8, (5, 6)))


def test_the_inverse_of_a_stack_inverts_each_transform(poses: np.ndarray) -> None:
    np.testing.assert_allclose(invert_poses(poses) @ poses, np.broadcast_to(np.eye(4), poses.shape), atol=1e-14)


def test_twists_and_poses_are_inverse(poses: np.ndarray) -> None:
    np.testing.assert_allclose(pose_from_twist(twist_from_pose(poses)), poses, atol=1e-14)


def test_cross_matrix_is_the_cross_product() -> None:
    a, b = np.random.default_rng(1).normal(size=(2, 4, 3))
    np.testing.assert_allclose((cross_matrix(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-14)


def test_adjoint_moves_small_changes_to_the_other_side(poses: np.ndarray) -> None:
    v = 1e-7 * np.random.default_rng(2).normal(size=(5, 6))
    carried = (adjoint(poses) @ v[..., None])[..., 0]
    # Terms of second order in 1e-7.
    np.testing.assert_allclose(poses @ pose_from_twist(v), pose_from_twist(carried) @ poses, atol=1e-12)


def test_right_jacobian_splits_a_motion() -> None:
    rng = np.random.default_rng(3)
    v, d = rng.normal(0, 0.02, (5, 6)), 1e-6 * rng.normal(size=(5, 6))
    split = pose_from_twist(v) @ pose_from_twist((right_jacobian(v) @ d[..., None])[..., 0])
    # The series is exact to the second power of 0.02, and the changes to the first power of 1e-6.
    np.testing.assert_allclose(pose_from_twist(v + d), split, atol=1e-11)


def test_rotation_angles_are_those_of_single_poses(poses: np.ndarray) -> None:
    tiny = pose_from_twist(np.array([[1e-9, 0, 0, 0, 0, 0]]))
    angles = rotation_angles(np.concatenate([poses, tiny])[:, :3, :3])
    np.testing.assert_allclose(angles, [rotation_angle(T) for T in (*poses, tiny[0])], rtol=1e-7)


def test_mean_pose_is_in_the_middle() -> None:
    v = np.array([[0.3, 0, 0, 1.0, 2, 3], [-0.3, 0, 0, 3.0, 2, 1]])
    np.testing.assert_allclose(
        mean_pose(pose_from_twist(v)), pose_from_twist(np.array([0, 0, 0, 2.0, 2, 2])), atol=1e-14
    )


def test_nearest_rotation_of_a_mirror_is_a_rotation() -> None:
    assert np.linalg.det(nearest_rotation(np.diag([1.0, 1.0, -1.0]))) == pytest.approx(1.0)
