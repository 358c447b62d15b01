"""Normals of a cylinder are radial and oriented towards the camera."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector
from recognition.errors import TooCrowdedError
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud, estimate_normals, smallest_eigenvectors
from recognition.preprocessing.target_cloud import TargetCloud

AXIS = np.column_stack([np.arange(-0.03, 0.03, 0.0003), np.zeros(200), np.zeros(200)])

TABLE_1 = ChainParameters.for_radius(0.0042)


def cloud_of(points: np.ndarray, viewpoint: tuple[float, float, float]) -> TargetCloud:
    T = np.eye(4)
    T[2, 3] = 0.001
    T_base_camera = from_rotation_vector(viewpoint, (np.pi, 0.0, 0.0))
    return TargetCloud(3, points, T_base_camera, T, len(points), len(points), False)


def angles(cloud: NormalCloud) -> tuple[np.ndarray, np.ndarray]:
    """Return the angle (N,) of each normal to the true one, and the angle (N,) of each point around the x axis."""
    radial = cloud.points * (0.0, 1.0, 1.0)
    radial /= np.linalg.norm(radial, axis=1, keepdims=True)
    cosine = (radial * cloud.normals).sum(axis=1)
    return np.arccos(np.clip(cosine, -1, 1)), np.arctan2(cloud.points[:, 2], cloud.points[:, 1])


@pytest.mark.parametrize("viewpoint", [(0.0, 0.0, 0.4), (0.1, 0.05, 0.4)])
def test_normals_of_a_cylinder_seen_from_above_are_radial(
    table_1: ChainParameters, tube: Callable, viewpoint: tuple[float, float, float]
) -> None:
    points, _ = tube(AXIS, table_1.r, 0.0, np.pi, around=60)
    cloud = estimate_normals(cloud_of(points, viewpoint), table_1)
    off, where = angles(cloud)
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, rtol=0, atol=1e-12)
    # PCA over 0.55 r sees an even neighbourhood everywhere but at the edge and at the ends, where it is one-sided;
    # voxel averages of r / 4 make it a little uneven. Three degrees move a centre by r sin 3 deg = 0.2 mm.
    inner = (np.abs(where - np.pi / 2) < np.radians(50)) & (np.abs(cloud.points[:, 0]) < 0.025)
    assert inner.sum() > 300
    assert off[inner].max() < np.radians(3)
    # One-sided, the largest error is half the angle of a chord of 0.55 r: 16 degrees.
    assert off.max() < np.radians(16)


def test_normals_are_oriented_towards_the_camera(table_1: ChainParameters, tube: Callable) -> None:
    for side in (1.0, -1.0):
        points, _ = tube(AXIS, table_1.r, 0.0, side * np.pi, around=60)
        cloud = estimate_normals(cloud_of(points, (0.0, 0.0, 0.4 * side)), table_1)
        off, _ = angles(cloud)
        # Outwards for the half that this camera sees, whichever half it is.
        assert off.max() < np.radians(90)
    # Seen from inside, the same surface has the opposite normals.
    points, _ = tube(AXIS, table_1.r, 0.0, np.pi, around=60)
    inwards = estimate_normals(cloud_of(points, (0.0, 0.0, -0.4)), table_1)
    off, where = angles(inwards)
    assert off[np.abs(where - np.pi / 2) < np.radians(50)].min() > np.radians(170)


def test_points_are_averaged_in_voxels_and_outliers_are_removed(table_1: ChainParameters, tube: Callable) -> None:
    points, _ = tube(AXIS, table_1.r, 0.0, np.pi, around=60)
    flying = np.array([[0.0, 0.02, 0.02], [0.02, -0.03, 0.01]])
    target = cloud_of(np.vstack([points, flying]), (0.0, 0.0, 0.4))
    cloud = estimate_normals(target, table_1)
    distance = np.linalg.norm(cloud.points[:, 1:], axis=1)
    # A mean over a voxel of r / 4 lies below the arc by less than the sagitta of its diagonal (about r / 20).
    assert distance.min() > 0.95 * table_1.r
    assert distance.max() <= table_1.r + 1e-9
    assert len(cloud.points) < len(points) / 4
    assert len(cloud.points) == len(cloud.normals)
    assert cloud.view == 3
    np.testing.assert_array_equal(cloud.T_correction, target.T_table_alignment)


def test_where_pixels_are_sparse_the_neighbourhood_grows(table_1: ChainParameters, tube: Callable) -> None:
    # One point every 1.5 mm: within 0.55 r of it there are three or four others.
    axis = np.column_stack([np.arange(-0.03, 0.03, 0.0015), np.zeros(40), np.zeros(40)])
    points, _ = tube(axis, table_1.r, 0.0, np.pi, around=9)
    cloud = estimate_normals(cloud_of(points, (0.0, 0.0, 0.4)), table_1)
    off, where = angles(cloud)
    inner = (np.abs(where - np.pi / 2) < np.radians(50)) & (np.abs(cloud.points[:, 0]) < 0.025)
    assert inner.sum() > 100
    assert off[inner].max() < np.radians(6)


def test_smallest_eigenvectors_agree_with_numpy() -> None:
    rng = np.random.default_rng(4)
    B = rng.standard_normal((500, 3, 3)) * (1.0, 1.0, 0.1)
    A = B @ B.transpose(0, 2, 1) * 1e-6
    axes = smallest_eigenvectors(A)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1.0, rtol=0, atol=1e-12)
    along = np.abs((axes * np.linalg.eigh(A)[1][:, :, 0]).sum(axis=1))
    # The closed form loses some digits where two eigenvalues are alike; a normal needs three.
    assert along.min() > 1 - 1e-6


def test_the_normal_of_a_degenerate_neighbourhood_is_vertical() -> None:
    nothing, ball, line = np.zeros((3, 3)), np.eye(3), np.diag([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(
        smallest_eigenvectors(np.array([nothing, ball, line])), np.tile((0.0, 0.0, 1.0), (3, 1))
    )
    in_one_position = estimate_normals(cloud_of(np.tile((0.1, 0.2, 0.03), (500, 1)), (0, 0, 0.4)), TABLE_1)
    assert in_one_position.points.shape == in_one_position.normals.shape == (1, 3)
    assert np.isfinite(in_one_position.normals).all()


def test_more_points_than_strings_have_are_an_error() -> None:
    plain = np.random.default_rng(0).uniform(0, 1.0, (150_000, 3)) * (1.0, 1.0, 0.1)
    with pytest.raises(TooCrowdedError, match=r"view 3 has 1[0-9]{5} points above the table, more than 100000"):
        estimate_normals(cloud_of(plain, (0, 0, 1.0)), TABLE_1)
