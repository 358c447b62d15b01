"""Normals of a cylinder are radial and on the camera's side."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.normals import NormalCloud, estimate_normals
from recognition.parameters import ChainParameters
from recognition.preprocess import TargetCloud

AXIS = np.column_stack([np.arange(-0.03, 0.03, 0.0003), np.zeros(200), np.zeros(200)])


def cloud_of(points: np.ndarray, viewpoint: tuple[float, float, float]) -> TargetCloud:
    T = np.eye(4)
    T[2, 3] = 0.001
    return TargetCloud(3, points, np.array(viewpoint), T, len(points), len(points), False)


def angles(cloud: NormalCloud) -> tuple[np.ndarray, np.ndarray]:
    """(N,) angle between each normal and the true one, and (N,) where the point lies around the x axis."""
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
    # PCA over 0.6 r sees an even neighbourhood everywhere but at the rim and at the ends, where it is one-sided;
    # voxel averages of r / 4 make it a little uneven. Three degrees move a centre by r sin 3 deg = 0.2 mm.
    inner = (np.abs(where - np.pi / 2) < np.radians(50)) & (np.abs(cloud.points[:, 0]) < 0.025)
    assert inner.sum() > 300
    assert off[inner].max() < np.radians(3)
    # One-sided, it is at most the chord of 0.6 r that decides: half its angle, 17 degrees.
    assert off.max() < np.radians(17)


def test_normals_are_on_the_side_of_the_camera(table_1: ChainParameters, tube: Callable) -> None:
    for side in (1.0, -1.0):
        points, _ = tube(AXIS, table_1.r, 0.0, side * np.pi, around=60)
        cloud = estimate_normals(cloud_of(points, (0.0, 0.0, 0.4 * side)), table_1)
        off, _ = angles(cloud)
        # Outwards for the half that this camera sees, whichever half it is.
        assert off.max() < np.radians(90)
    # Seen from within, the same surface has its normals turned round.
    points, _ = tube(AXIS, table_1.r, 0.0, np.pi, around=60)
    inwards = estimate_normals(cloud_of(points, (0.0, 0.0, -0.4)), table_1)
    off, where = angles(inwards)
    assert off[np.abs(where - np.pi / 2) < np.radians(50)].min() > np.radians(170)


def test_the_cloud_is_thinned_evenly_and_freed_of_outliers(table_1: ChainParameters, tube: Callable) -> None:
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
    np.testing.assert_array_equal(cloud.T_correction, target.T_levelling)
