"""Points of two views on the same piece of surface."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.geometry.transforms import from_rotation_vector, inverse
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import (
    MAX_ANCHORS,
    MIN_ANCHORS,
    MIN_PAIRS,
    anchor_points,
    find_correspondences,
)
from recognition.registration.registration import transform_cloud

AXIS = np.column_stack([np.arange(0.0, 0.1, 0.001), np.zeros(100), np.zeros(100)])


@pytest.fixture
def half(table_1: ChainParameters, tube: Callable) -> Callable[..., NormalCloud]:
    """`half(view, low, high)`: the cloud of a straight string between two angles, in degrees."""

    def make(view: int, low: float, high: float) -> NormalCloud:
        points, normals = tube(AXIS, table_1.r, np.radians(low), np.radians(high), around=19)
        return NormalCloud(view, points, normals, np.eye(4))

    return make


def test_only_surface_in_both_views_is_paired(table_1: ChainParameters, half: Callable) -> None:
    # 19 points around: one every 5 degrees. 60 to 90 degrees are in both.
    right, left = half(3, 0, 90), half(5, 60, 150)
    (overlap,) = find_correspondences(left, [right], table_1, max_distance_radii=0.05)
    assert (overlap.source_view, overlap.target_view) == (5, 3)
    np.testing.assert_allclose(
        left.points[overlap.source_indices], right.points[overlap.target_indices], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(overlap.distances, 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(overlap.cosines, 1.0, rtol=0, atol=1e-12)
    height = np.degrees(np.arcsin(left.points[overlap.source_indices, 2] / table_1.r))
    assert 60 - 1e-6 < height.min() < 66
    # All anchor points there have a partner. They are at 7 of the 19 angles.
    assert len(overlap.source_indices) == pytest.approx(overlap.n_searched * 7 / 19, rel=0.1)


def test_surfaces_back_to_back_are_not_the_same(table_1: ChainParameters, half: Callable) -> None:
    cloud = half(0, 0, 90)
    inside_out = NormalCloud(1, cloud.points, -cloud.normals, np.eye(4))
    assert find_correspondences(inside_out, [cloud], table_1) == []


def test_too_few_pairs_give_no_correspondences(table_1: ChainParameters, half: Callable) -> None:
    cloud = half(0, 0, 90)
    for count in (MIN_PAIRS - 1, MIN_PAIRS):
        few = NormalCloud(1, cloud.points[:count], cloud.normals[:count], np.eye(4))
        assert len(find_correspondences(few, [cloud], table_1)) == (count == MIN_PAIRS)


def test_clouds_are_compared_where_they_are_moved_to(table_1: ChainParameters, half: Callable) -> None:
    first, second = half(0, 0, 120), half(1, 20, 140)
    T, T_other = from_rotation_vector((0.3, 0, 0.1), (0.5, 0.2, 1)), from_rotation_vector((0, -0.2, 0), (0, 0, -1))
    away = transform_cloud(second, inverse(T)), transform_cloud(first, inverse(T_other))
    assert find_correspondences(away[0], [away[1]], table_1) == []
    (there,) = find_correspondences(away[0], [away[1]], table_1, T=T, T_others=[T_other])
    (here,) = find_correspondences(second, [first], table_1)
    # Rounding may select the other one of two equally distant points.
    np.testing.assert_allclose(there.distances, here.distances, rtol=0, atol=1e-12)
    np.testing.assert_allclose(there.cosines, here.cosines, rtol=0, atol=1e-12)


def test_fewer_points_are_searched_in_each_of_many_views(table_1: ChainParameters, half: Callable) -> None:
    cloud, other = half(99, 0, 90), half(0, 0, 90)
    for count in (1, 7, 14, 200):
        others = [replace(other, view=k) for k in range(count)]
        n_searched = [overlap.n_searched for overlap in find_correspondences(cloud, others, table_1)]
        assert len(n_searched) == count
        assert max(n_searched) <= max(MAX_ANCHORS * min(1.0, 7 / count), MIN_ANCHORS)


def test_anchors_are_bounded_and_spread(half: Callable) -> None:
    cloud = half(0, 0, 90)
    chosen = anchor_points(cloud)
    assert MAX_ANCHORS / 2 < len(chosen) <= MAX_ANCHORS
    assert np.ptp(np.diff(chosen)) == 0
    assert anchor_points(cloud, 10_000).tolist() == list(range(1900))
