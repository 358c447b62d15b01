"""Sigmas and view counts of fitted strands, compared with values computed by hand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.hidden_lengths import (
    BEND_LENGTH_RADII,
    STRAIGHT_DENSITY,
    bending_density,
    hidden_variance,
)
from recognition.assembly.uncertainty import (
    MIN_SIGMA_M,
    SYSTEMATIC_SHARE,
    SYSTEMATIC_VIEWS,
    point_uncertainty,
)
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
    np.testing.assert_allclose(sigma, np.sqrt(1.5 * POSE_M**2 / number + MIN_SIGMA_M**2), rtol=1e-9, atol=0)


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
        np.testing.assert_allclose(sigma, np.hypot(0.01 * lever, MIN_SIGMA_M), rtol=1e-9, atol=0)


def test_a_displacement_along_the_string_is_no_error(seen: Callable, straight: Callable, registered: Callable) -> None:
    sigma, _ = point_uncertainty(strand(), turned_by(registered(views(seen, straight, 0.11)), 3, 0.01), 0.0)
    np.testing.assert_allclose(sigma, MIN_SIGMA_M, rtol=1e-9, atol=0)


def test_the_variance_of_the_fit_follows_scatter_and_support(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    taken = registered(views(seen, straight, 0.11), 0.0)
    excess = [
        point_uncertainty(strand(support=support), taken, scatter)[0] ** 2
        - MIN_SIGMA_M**2
        - (SYSTEMATIC_SHARE * scatter) ** 2 * SYSTEMATIC_VIEWS
        for scatter, support in ((0.0002, 40.0), (0.0004, 40.0), (0.0002, 10.0))
    ]
    # Variances go with the scatter's square and with one over the number of points.
    np.testing.assert_allclose(excess[1] / excess[0], 4, rtol=1e-6, atol=0)
    np.testing.assert_allclose(excess[2] / excess[0], 4, rtol=1e-6, atol=0)
    assert excess[0].min() > 0


def test_errors_of_neighbouring_pixels_are_averaged_over_the_views_only(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    scatter = 0.0003

    def common(number: int) -> float:
        taken = registered(views(seen, straight, *[0.11] * number), 0.0)
        sigma, _ = point_uncertainty(strand(support=1e12), taken, scatter)
        return float(sigma[10] ** 2 - MIN_SIGMA_M**2)

    # A single view has nearly all of the scatter, however many of its pixels are beside the point.
    assert common(1) == pytest.approx(scatter**2, rel=0.05)
    for number in (2, 4, 8):
        assert common(number) == pytest.approx(common(1) / number, rel=1e-6)
    assert common(9) == pytest.approx(common(8), rel=1e-6)


def test_bridges_are_less_certain_towards_their_middle(
    seen: Callable, straight: Callable, registered: Callable
) -> None:
    hidden = (X > 0.04) & (X < 0.06)
    sigma, _ = point_uncertainty(strand(hidden), registered(views(seen, straight, 0.11), 0.0), 0.0)
    np.testing.assert_allclose(sigma[~hidden], MIN_SIGMA_M, rtol=1e-9, atol=0)
    # Between given ends and directions, a spline of density q leaves a line by q x^3 (L - x)^3 / 3 L^3 at x, in both
    # directions across. Directions are those of the last visible links, whose middles are half a step outside the gap.
    x, length = X[hidden] - X[hidden][0] + 1.5 * 0.7 * R, np.ptp(X[hidden]) + 3 * 0.7 * R
    spread = 1.5 * STRAIGHT_DENSITY / R * x**3 * (length - x) ** 3 / (3 * length**3)
    np.testing.assert_allclose(sigma[hidden] ** 2 - MIN_SIGMA_M**2, spread, rtol=0.1, atol=0)
    middle = hidden.sum() // 2
    assert (np.diff(sigma[hidden][: middle + 1]) > 0).all()
    # The fit beside a bridge is uncertain in position and direction, and so is the bridge.
    noisy, _ = point_uncertainty(strand(hidden), registered(views(seen, straight, 0.11), 0.0), 0.0003)
    assert (noisy[hidden] > sigma[hidden]).all()


def test_bridges_of_strings_that_bend_more_are_less_certain() -> None:
    hidden = (X > 0.04) & (X < 0.06)
    turn = X / (10 * R)
    arc = np.column_stack([10 * R * np.sin(turn), 10 * R * (1 - np.cos(turn)), np.full_like(X, R)])
    bent = replace(strand(hidden), points=arc)
    assert bending_density(bent, 0.7 * R) == pytest.approx(BEND_LENGTH_RADII * R / (10 * R) ** 2 / 2, rel=0.02)
    fit_variance = np.full(len(X), 1e-12)
    grown = hidden_variance(bent, fit_variance) / hidden_variance(strand(hidden), fit_variance)
    np.testing.assert_allclose(grown, BEND_LENGTH_RADII / 200 / STRAIGHT_DENSITY, rtol=0.05, atol=0)


def test_a_hidden_end_is_less_certain_than_a_bridge_and_a_ring_has_no_ends() -> None:
    fit_variance = np.full(len(X), 1e-10)
    first = np.arange(len(X)) < 6
    end = hidden_variance(strand(first), fit_variance)
    assert (np.diff(end) < 0).all()
    assert end[0] > 20 * hidden_variance(strand(np.roll(first, 10)), fit_variance).max()
    angle = 2 * np.pi * np.arange(len(X)) / len(X)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(X))]) * 0.7 * R * len(X) / (2 * np.pi)
    rings = [replace(strand(np.roll(first, by)), points=np.roll(circle, by, axis=0), closed=True) for by in (-3, 10)]
    across, within = (np.sort(hidden_variance(ring, fit_variance)) for ring in rings)
    np.testing.assert_allclose(across, within, rtol=0.02, atol=0)


def test_a_strand_that_no_view_saw_is_finite(registered: Callable) -> None:
    # A strand bridged all along, and a view with nothing near it.
    elsewhere = (np.array([(5.0, 5.0, 5.0)] * 5), np.array([(0.0, 0.0, 1.0)] * 5))
    sigma, count = point_uncertainty(strand(np.ones(len(X), dtype=bool)), registered([elsewhere]), 0.0002)
    assert np.isfinite(sigma).all()
    assert sigma.min() > 10 * MIN_SIGMA_M
    np.testing.assert_array_equal(count, 0)
