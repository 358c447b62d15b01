"""Merging of all views into one cloud."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import KDTree

from recognition.errors import TooCrowdedError
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.fusion import MAX_POINTS, merge_clouds

ARC = np.column_stack([np.cos(np.linspace(0, 3, 250)), np.sin(np.linspace(0, 3, 250)), np.zeros(250)]) * 0.06


def test_merging_averages_removes_outliers_and_keeps_unit_normals(table_1: ChainParameters, tube: Callable) -> None:
    clouds = []
    for k in range(3):
        points, normals = tube(ARC, table_1.r, np.radians(20 * k), np.radians(140 + 20 * k), around=18)
        noise = 0.0001 * np.random.default_rng(k).standard_normal(points.shape)
        clouds.append(NormalCloud(k, points + noise, normals, np.eye(4)))
    far = NormalCloud(9, np.array([[0.0, 0.0, 0.08]]), np.array([[0.0, 0.0, 1.0]]), np.eye(4))
    points, normals = merge_clouds([*clouds, far], table_1)
    assert points.shape == normals.shape
    assert len(points) < sum(len(cloud.points) for cloud in clouds) / 4
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0, atol=1e-12)
    assert points[:, 2].max() < 0.01
    # Means over voxels of r / 3 lie under the surface by up to the sagitta of their diagonal, r / 24.
    assert np.abs(KDTree(ARC).query(points)[0] - table_1.r).max() < table_1.r / 24 + 0.0004


def test_a_point_with_opposite_normals_has_no_side(table_1: ChainParameters) -> None:
    x, y = np.meshgrid(np.linspace(0, 0.022, 12), np.linspace(0, 0.022, 12))
    sheet = np.column_stack([x.ravel(), y.ravel(), np.zeros(144)])
    up = np.tile((0.0, 0.0, 1.0), (144, 1))
    down = up.copy()
    # The second view sees half of the sheet from below.
    down[sheet[:, 0] > 0.011] *= -1
    points, normals = merge_clouds(
        [NormalCloud(0, sheet, up, np.eye(4)), NormalCloud(1, sheet, down, np.eye(4))], table_1
    )
    assert points[:, 0].max() < 0.011
    np.testing.assert_allclose(normals, np.tile((0.0, 0.0, 1.0), (len(points), 1)), rtol=0, atol=1e-12)


def test_more_points_than_strings_have_are_an_error(table_1: ChainParameters) -> None:
    points = np.random.default_rng(0).uniform(0, 2.0, (MAX_POINTS + 5000, 3))
    cloud = NormalCloud(0, points, np.tile((0.0, 0.0, 1.0), (len(points), 1)), np.eye(4))
    with pytest.raises(TooCrowdedError, match=r"the views together have 15[0-9]{4} points above the table"):
        merge_clouds([cloud], table_1)
