"""Points of two views on the same piece of surface."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from calibration.geometry.transforms import from_rotation_vector, inverse
from cell.planning.look_at import look_at, two_rings
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import (
    MAX_ANCHORS,
    MAX_EARLIER_VIEWS,
    MIN_PAIRS,
    N_FULLY_COMPARED,
    anchor_points,
    compared_earlier_views,
    compared_views,
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


def ring(count: int) -> list[NormalCloud]:
    """Return views on two rings about the origin, without surface."""
    poses = [look_at(np.zeros(3), b.azimuth_rad, b.elevation_rad, 0.35, b.roll_rad) for b in two_rings(count)]
    nothing = np.zeros((1, 3))
    return [NormalCloud(k, nothing, nothing, np.eye(4), T) for k, T in enumerate(poses)]


@pytest.mark.parametrize("count", [1, 2, N_FULLY_COMPARED])
def test_few_views_are_all_compared(count: int) -> None:
    np.testing.assert_array_equal(compared_views(ring(count)), ~np.eye(count, dtype=bool))


def test_pairs_of_views_grow_with_the_number_of_views() -> None:
    n_pairs = {count: int(compared_views(ring(count)).sum()) // 2 for count in (8, 16, 32, 64)}
    assert n_pairs[8] == 28
    # As many more pairs for each further view.
    assert n_pairs[64] - n_pairs[32] == 2 * (n_pairs[32] - n_pairs[16]) == 32 * MAX_EARLIER_VIEWS
    assert n_pairs[32] < 4.5 * n_pairs[8]


@pytest.mark.parametrize("seed", range(5))
def test_all_views_hang_together_in_any_order_of_arrival(seed: int) -> None:
    # Two distant groups of 16 views: the nearest of all views of each one are in its own group.
    away = [transform_cloud(cloud, from_rotation_vector((1.0, 0, 0), (0, 0, 0))) for cloud in ring(16)]
    clouds = [*ring(16), *(replace(cloud, view=16 + cloud.view) for cloud in away)]
    order = np.arange(32) if seed == 0 else np.random.default_rng(seed).permutation(32)
    is_compared = compared_views([clouds[k] for k in order])
    np.testing.assert_array_equal(is_compared, is_compared.T)
    assert not is_compared.diagonal().any()
    assert connected_components(is_compared)[0] == 1
    # A choice is not changed by later views.
    np.testing.assert_array_equal(compared_views([clouds[k] for k in order[:20]]), is_compared[:20, :20])


def test_a_view_is_compared_with_the_nearest_earlier_ones() -> None:
    first, *others = ring(24)
    # The last view is at the first viewpoint again, slightly rotated: 0, its neighbours on both sides, and so on.
    assert first.T_base_camera is not None
    T = first.T_base_camera @ from_rotation_vector((0, 0, 0), (0.001, 0, 0))
    again = replace(first, view=24, T_base_camera=T)
    assert compared_earlier_views([first, *others, again]).tolist() == [0, 2, 22, 23]
    # From one position, the viewing direction decides.
    tilted = [
        replace(first, view=k, T_base_camera=first.T_base_camera @ from_rotation_vector((0, 0, 0), (0.05 * k, 0, 0)))
        for k in range(20)
    ]
    assert compared_earlier_views([*tilted, replace(tilted[10], view=20)]).tolist() in ([8, 9, 10, 11], [9, 10, 11, 12])


def test_anchors_are_bounded_and_spread(half: Callable) -> None:
    cloud = half(0, 0, 90)
    chosen = anchor_points(cloud)
    assert MAX_ANCHORS / 2 < len(chosen) <= MAX_ANCHORS
    assert np.ptp(np.diff(chosen)) == 0
    assert anchor_points(cloud, 10_000).tolist() == list(range(1900))
