"""The statistical outlier filter."""

import numpy as np
import pytest

from recognition.geometry.outlier_filter import LINE_RATIO, NEIGHBOURS, SURFACE_RATIO, inlier_mask


def sheet() -> np.ndarray:
    """(900, 3) points of a flat grid of 1 mm."""
    x, y = np.meshgrid(np.arange(30), np.arange(30))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(900)]) * 0.001


def test_points_off_a_surface_are_removed_and_the_surface_is_kept() -> None:
    off = np.array([[0.015, 0.015, 0.02], [0.06, 0.0, 0.0], [-0.03, 0.01, 0.001]])
    points = np.vstack([sheet(), off])
    # Shuffled: the answer must not depend on the order.
    order = np.random.default_rng(1).permutation(len(points))
    mask = inlier_mask(points[order])
    assert mask.dtype == bool
    np.testing.assert_array_equal(np.sort(order[~mask]), [900, 901, 902])


def test_an_even_cloud_on_a_circle_has_no_outlier() -> None:
    # Every point has the same neighbourhood, so that their distances differ by rounding only.
    angle = np.arange(400) / 400 * 2 * np.pi
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(400)]) * 0.1
    assert inlier_mask(circle, LINE_RATIO).all()


@pytest.mark.parametrize("ratio", [1.0, SURFACE_RATIO, LINE_RATIO])
def test_the_rule_by_brute_force(ratio: float) -> None:
    rng = np.random.default_rng(3)
    points = np.vstack([rng.normal(size=(400, 3)), rng.normal(size=(20, 3)) * 4, rng.normal(size=(2, 3)) * 20])
    D = np.sort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1)
    # Open3D counts the point itself among its neighbours.
    mean = D[:, :NEIGHBOURS].mean(axis=1)
    expected = mean <= mean.mean() + ratio * mean.std(ddof=1)
    assert not expected.all()
    np.testing.assert_array_equal(inlier_mask(points, ratio), expected)


def test_a_cloud_too_small_for_the_statistic_is_kept() -> None:
    scattered = np.random.default_rng(2).uniform(size=(NEIGHBOURS, 3)) ** 5
    assert inlier_mask(scattered).tolist() == [True] * NEIGHBOURS
    assert inlier_mask(np.empty((0, 3))).shape == (0,)


def test_coincident_points_are_not_outliers() -> None:
    # The centre points of an exact cylinder coincide ring by ring.
    rings = np.repeat(np.linspace((0.0, 0.0, 0.0), (0.049, 0.0, 0.0), 50), 24, axis=0)
    assert inlier_mask(rings).all()
