"""Means of the points in each voxel, and centres of the occupied voxels."""

import numpy as np

from recognition.geometry.voxel_grid import voxel_centres, voxel_means


def test_means_by_hand() -> None:
    points = np.array([[0.0, 0, 0], [0.3, 0, 0], [2.5, 0, 0], [0.1, 1.9, 0.2]])
    values = np.array([[1.0], [3.0], [5.0], [7.0]])
    means, value_means = voxel_means(points, 1.0, values)
    np.testing.assert_allclose(means, [(0.15, 0, 0), (0.1, 1.9, 0.2), (2.5, 0, 0)], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(value_means, [[2.0], [7.0], [5.0]])


def test_means_agree_with_a_dictionary_of_voxels() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-3, 5, (400, 3))
    boxes: dict[tuple[int, ...], list[np.ndarray]] = {}
    for point in points:
        boxes.setdefault(tuple(np.floor((point - points.min(axis=0)) / 0.9).astype(int)), []).append(point)
    expected = np.array([np.mean(boxes[key], axis=0) for key in sorted(boxes)])
    means, _ = voxel_means(points, 0.9)
    np.testing.assert_allclose(means, expected, rtol=0, atol=1e-12)


def test_no_points_give_no_means() -> None:
    means, values = voxel_means(np.empty((0, 3)), 0.1, np.empty((0, 2)))
    assert (means.shape, values.shape) == ((0, 3), (0, 2))


def test_the_centres_of_occupied_voxels_are_on_a_grid_through_the_origin() -> None:
    points = np.random.default_rng(2).uniform(-2, 3, (400, 3))
    expected = (np.unique(np.floor(points / 0.7), axis=0) + 0.5) * 0.7
    np.testing.assert_array_equal(voxel_centres(points, 0.7), expected)
    assert voxel_centres(np.empty((0, 3)), 0.7).shape == (0, 3)
