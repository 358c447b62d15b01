"""Sigmas and view counts of fitted strands, compared with values computed by hand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.uncertainty import DEPTH_FACTOR, MIN_SIGMA_M, point_uncertainty
from recognition.preprocessing.table_scatter import TableScatter
from recognition.refinement.refinement import FittedStrand
from recognition.registration.registration import Registration

R = 0.0042
X = np.arange(0.0, 0.1001, 0.7 * R)
POSE_M = 0.0004


def strand(hidden: np.ndarray | None = None, support: float = 40.0) -> FittedStrand:
    points = np.column_stack([X, np.zeros_like(X), np.full_like(X, R)])
    bridged = np.zeros(len(X), dtype=bool) if hidden is None else hidden
    return FittedStrand(points, False, bridged, np.where(bridged, 0.0, support), R, R, 0.35, 0.0, 0.05)


def views(seen: Callable, straight: Callable, *ends: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """The surface that each view saw: the string from x = -10 mm to one of `ends`."""
    return [seen([straight((-0.01, 0, R), (end, 0, R))]) for end in ends]


def test_views_are_counted_point_by_point(seen: Callable, straight: Callable, registered: Callable) -> None:
    _, count = point_uncertainty(strand(), registered(views(seen, straight, 0.11, 0.05, 0.03)), 0.0)
    assert np.issubdtype(count.dtype, np.integer)
    # The last points of a view belong to the nearest point of the line, up to half a step farther.
    np.testing.assert_array_equal(count, 1 + (X < 0.05 + 0.35 * R) + (X < 0.03 + 0.35 * R))


def test_bridged_points_have_no_views(seen: Callable, straight: Callable, registered: Callable) -> None:
    hidden = (X > 0.04) & (X < 0.06)
    # Even where there is surface, of the strand that hides it.
    _, count = point_uncertainty(strand(hidden), registered(views(seen, straight, 0.11, 0.11)), 0.0)
    np.testing.assert_array_equal(count, np.where(hidden, 0, 2))


def test_specks_and_other_strands_do_not_count_as_views(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    beside = seen([straight((0, 2 * R, R), (0.1, 2 * R, R))])
    far_side = beside[0][:, 1] > 1.7 * R
    two_points = (np.array([(0.05, 0.0, 2 * R)] * 2), np.array([(0.0, 0.0, 1.0)] * 2))
    _, count = point_uncertainty(strand(), registered([two_points, (beside[0][far_side], beside[1][far_side])]), 0.0)
    np.testing.assert_array_equal(count, 0)


@pytest.mark.parametrize("number", [2, 4, 8])
def test_more_views_are_better(seen: Callable, straight: Callable, registered: Callable, number: int) -> None:
    # Independent views of POSE_M in each direction: the mean of n has a variance of 1 / n of it, and of the two
    # directions across the string one counts whole and the other half.
    sigma, _ = point_uncertainty(strand(), registered(views(seen, straight, *[0.11] * number), POSE_M), 0.0)
    np.testing.assert_allclose(sigma, np.sqrt(1.5 * POSE_M**2 / number), rtol=1e-6, atol=0)


def turned_by(registration: Registration, about: int, sigma_rad: float) -> Registration:
    covariance = np.zeros((6, 6))
    covariance[about, about] = sigma_rad**2
    return Registration(
        registration.points, registration.normals, registration.clouds, (), registration.centre, covariance
    )


def test_a_rotation_counts_by_its_lever(seen: Callable, straight: Callable, registered: Callable) -> None:
    one_view = registered(views(seen, straight, 0.11))
    for about, lever in ((2, X), (1, X), (0, np.full_like(X, R))):
        # About z it moves the string sideways, about y up and down; about its own direction only by its height.
        sigma, _ = point_uncertainty(strand(), turned_by(one_view, about, 0.01), 0.0)
        np.testing.assert_allclose(sigma, np.maximum(0.01 * lever, MIN_SIGMA_M), rtol=1e-6, atol=0)


def test_a_displacement_along_the_string_is_no_error(seen: Callable, straight: Callable, registered: Callable) -> None:
    sigma, _ = point_uncertainty(strand(), turned_by(registered(views(seen, straight, 0.11)), 3, 0.01), 0.0)
    np.testing.assert_allclose(sigma, MIN_SIGMA_M, rtol=1e-9, atol=0)


def test_slow_errors_of_the_depth_are_averaged_over_the_views_only(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    scatter, patch = 0.0003, 0.0005

    def common(number: int, patch_m: float | None = None) -> float:
        taken = registered(views(seen, straight, *[0.11] * number), 0.0)
        clouds = tuple(replace(cloud, scatter=TableScatter(0.0, patch_m)) for cloud in taken.clouds)
        sigma, _ = point_uncertainty(strand(support=1e12), replace(taken, clouds=clouds), scatter)
        return float(sigma[10] ** 2)

    # The variance in each direction is 6/5 of that of a patch (see below). Half of the second direction counts. Without
    # enough table, the scatter of the string replaces that of the patches.
    assert common(1, patch) == pytest.approx(1.8 * patch**2, rel=0.01)
    assert common(1) == pytest.approx(1.8 * scatter**2, rel=0.01)
    # Patches whose pixels are independent are no unknown patches.
    assert common(1, 0.0) == MIN_SIGMA_M**2
    for number in (2, 4, 8):
        assert common(number, patch) == pytest.approx(common(1, patch) / number, rel=1e-3)
    assert common(9, patch) == pytest.approx(common(8, patch), rel=1e-6)


def test_errors_of_narrow_areas_move_a_tube_by_six_fifths_of_a_patch() -> None:
    # Depth errors along the vertical, each on 1/50 of the width. A tube is fitted to them along its normals.
    x = (np.arange(50) + 0.5) / 25 - 1
    normals = np.column_stack([x, np.sqrt(1 - x**2)])
    errors = np.random.default_rng(0).standard_normal((20_000, 50))
    moved = np.linalg.lstsq(normals, (errors * normals[:, 1]).T, rcond=None)[0]
    np.testing.assert_allclose(moved.var(axis=1) / errors.mean(axis=1).var(), DEPTH_FACTOR / 1.5, rtol=0.03, atol=0)


def test_a_point_that_fewer_views_saw_is_less_certain(seen: Callable, straight: Callable, registered: Callable) -> None:
    hidden = (X > 0.04) & (X < 0.06)
    taken = registered(views(seen, straight, 0.11, *[0.05] * 7), 0.0)
    clouds = tuple(replace(cloud, scatter=TableScatter(0.0, 0.0005)) for cloud in taken.clouds)
    sigma, _ = point_uncertainty(strand(support=1e9), replace(taken, clouds=clouds), 0.0)
    assert sigma[-3] == pytest.approx(np.sqrt(8) * sigma[3], rel=0.01)
    # A hidden length is as uncertain as the visible lengths beside it, and more.
    bridge, _ = point_uncertainty(strand(hidden, 1e9), replace(taken, clouds=clouds), 0.0)
    assert (bridge[hidden] > 1.05 * sigma[3]).all()
    assert (np.diff(bridge[hidden]) > 0).all()


def test_a_strand_that_no_view_saw_is_finite(registered: Callable) -> None:
    # A strand bridged all along, and a view with nothing near it.
    elsewhere = (np.array([(5.0, 5.0, 5.0)] * 5), np.array([(0.0, 0.0, 1.0)] * 5))
    sigma, count = point_uncertainty(strand(np.ones(len(X), dtype=bool)), registered([elsewhere]), 0.0002)
    assert np.isfinite(sigma).all()
    assert sigma.min() > 10 * MIN_SIGMA_M
    np.testing.assert_array_equal(count, 0)
