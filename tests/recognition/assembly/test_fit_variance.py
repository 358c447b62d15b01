"""Variance of fitted strands against drawn strings that are fitted with the bending penalty."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.fit_variance import (
    BEND_LENGTH_RADII,
    BEND_POINTS,
    STRAIGHT_DENSITY,
    WINDOW_POINTS,
    bending_density,
    fit_variance,
)
from recognition.refinement.refinement import FittedStrand
from recognition.refinement.tube_fit import BEND_SIGMA_RADII

R = 0.0042
STEP = 0.7 * R
SCATTER_M = 0.0003


def strand(points: np.ndarray, hidden: np.ndarray | None = None, support: float = 40.0) -> FittedStrand:
    bridged = np.zeros(len(points), dtype=bool) if hidden is None else hidden
    return FittedStrand(points, False, bridged, np.where(bridged, 0.0, support), R, R, 0.35, 0.0, 0.05)


def straight(count: int) -> np.ndarray:
    return np.column_stack([STEP * np.arange(count), np.zeros(count), np.zeros(count)])


def fitted(measured: np.ndarray, hidden: np.ndarray, support: float) -> np.ndarray:
    """Return the points (N, 3) of a smoothing spline with the bending penalty of the tube fit."""
    second = np.diff(np.eye(len(measured)), 2, axis=0)
    A = np.diag(np.where(hidden, 1e-3, support / (2 * SCATTER_M**2)))
    line = np.linalg.solve(A + second.T @ second / (BEND_SIGMA_RADII * R) ** 2, A @ measured)
    return np.column_stack([measured[:, 0], line[:, 1:]])


def drawn(rng: np.random.Generator, count: int, bend_radius: float) -> np.ndarray:
    """Return the points (N, 3) of a string along x, whose curvature stays the same over `BEND_POINTS` points."""
    curvature = rng.standard_normal((count, 2)) / bend_radius
    runs = np.cumsum(np.vstack([np.zeros((1, 2)), curvature]), axis=0)
    curvature = (runs[BEND_POINTS:] - runs[:-BEND_POINTS]) / np.sqrt(BEND_POINTS)
    across = np.cumsum(np.cumsum(curvature * STEP**2, axis=0), axis=0)
    return np.column_stack([STEP * np.arange(len(across)), across])


@pytest.mark.parametrize("bend_radius", [12 * R, 40 * R])
@pytest.mark.parametrize("support", [160.0, 40.0])
def test_drawn_strings_lie_within_the_variance(bend_radius: float, support: float) -> None:
    rng = np.random.default_rng(5)
    squared = []
    for _ in range(200):
        truth = drawn(rng, 40, bend_radius)
        hidden = np.abs(np.arange(len(truth)) - 20) <= 3
        noise = rng.standard_normal((len(truth), 2)) * np.sqrt(2 * SCATTER_M**2 / support)
        line = fitted(truth + np.column_stack([np.zeros(len(truth)), noise]), hidden, support)
        error = (line - truth)[:, 1:]
        squared.append((error**2).sum(axis=1) / 2 * 1.5 / fit_variance(strand(line, hidden, support), SCATTER_M))
    mean = np.mean(squared, axis=0)
    assert 0.5 < np.median(mean[5:14]) < 1.2
    assert 0.5 < np.median(mean[18:23]) < 1.5


def test_the_penalty_makes_a_sharp_bend_less_certain_if_little_surface_shows_it() -> None:
    corner = straight(41)
    corner[20:, 1] = STEP * np.arange(21)
    for support in (20.0, 40.0, 1000.0):
        line = fitted(corner, np.zeros(41, dtype=bool), support)
        error = np.abs(line - corner)[20, 1]
        sigma = np.sqrt(fit_variance(strand(line, support=support), SCATTER_M))
        # The penalty has pulled the corner of the fitted line less than it would have pulled that of the true line.
        assert 0.3 * error < sigma[20] < 2 * error + 3 * SCATTER_M / np.sqrt(support)
        assert sigma[20] > 2 * sigma[5]


def test_the_variance_of_the_noise_follows_scatter_and_support() -> None:
    line = strand(straight(30), support=1e5)
    few, noisy = replace(line, support=line.support / 4), fit_variance(line, 2 * SCATTER_M)
    expected = 4 * fit_variance(line, SCATTER_M)
    np.testing.assert_allclose(noisy, expected, rtol=0.02, atol=0)
    np.testing.assert_allclose(fit_variance(few, SCATTER_M), expected, rtol=0.02, atol=0)
    # Both directions have the same variance; half of the second counts.
    np.testing.assert_allclose(expected / 4, 1.5 * 2 * SCATTER_M**2 / 1e5, rtol=0.02, atol=0)


def test_bridges_are_less_certain_towards_their_middle() -> None:
    n = 61
    hidden = np.abs(np.arange(n) - 30) <= 15
    variance = fit_variance(strand(straight(n), hidden, 1e9), SCATTER_M)
    # Between given ends and directions, a spline of density q leaves a line by q x^3 (L - x)^3 / 3 L^3 at x, in both
    # directions across. Directions are those of the last visible links, whose middles are half a step outside the gap.
    x, length = (np.arange(31) + 1.5) * STEP, 33 * STEP
    spread = 1.5 * STRAIGHT_DENSITY / R * x**3 * (length - x) ** 3 / (3 * length**3)
    np.testing.assert_allclose(variance[hidden][10:21], spread[10:21], rtol=0.1, atol=0)
    assert (np.diff(variance[hidden][:16]) > 0).all()
    # The fit beside a bridge is uncertain in position and direction, and so is the bridge.
    assert (fit_variance(strand(straight(n), hidden), SCATTER_M)[hidden] > variance[hidden]).all()


def test_a_knot_bends_more_than_its_tails() -> None:
    # A tail, a loop and a hidden length in each.
    angle = np.linspace(0.0, 2.5 * np.pi, round(2.5 * np.pi * 4 / 0.7))
    loop = 4 * R * np.column_stack([np.sin(angle), 1 - np.cos(angle), 0.1 * angle])
    points = np.vstack([straight(50) - (50 * STEP, 0, 0), loop])
    density = bending_density(strand(points), STEP)
    assert density[65] == pytest.approx(BEND_LENGTH_RADII * R / (4 * R) ** 2 / 2, rel=0.1)
    assert density[20] < density[65] / 10
    hidden = np.zeros(len(points), dtype=bool)
    hidden[18:23] = hidden[63:68] = True
    variance = fit_variance(strand(points, hidden, 1e6), SCATTER_M)
    assert variance[65] > 5 * variance[20]


def test_a_hidden_end_is_less_certain_than_a_bridge_and_a_ring_has_no_ends() -> None:
    n = 35
    first = np.arange(n) < 6
    end = fit_variance(strand(straight(n), first, 400.0), SCATTER_M)
    assert (np.diff(end[:6]) < 0).all()
    bridge = fit_variance(strand(straight(n), np.roll(first, 10), 400.0), SCATTER_M)
    assert end[0] > 20 * bridge[10:16].max()
    angle = 2 * np.pi * np.arange(n) / n
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.ones(n)]) * STEP * n / (2 * np.pi)
    rings = [replace(strand(np.roll(circle, by, axis=0), np.roll(first, by), 400.0), closed=True) for by in (-3, 0, 10)]
    variances = [np.roll(fit_variance(ring, SCATTER_M), -by) for ring, by in zip(rings, (-3, 0, 10), strict=True)]
    np.testing.assert_allclose(variances[0], variances[1], rtol=0.02, atol=0)
    np.testing.assert_allclose(variances[0], variances[2], rtol=0.02, atol=0)


def test_a_long_strand_is_computed_in_parts_without_a_seam() -> None:
    line = strand(straight(3 * WINDOW_POINTS))
    hidden = np.abs(np.arange(len(line.points)) - WINDOW_POINTS) <= 3
    long = fit_variance(replace(line, bridged=hidden, support=np.where(hidden, 0.0, 40.0)), SCATTER_M)
    np.testing.assert_allclose(long[WINDOW_POINTS - 20 : WINDOW_POINTS], long[WINDOW_POINTS + 20 : WINDOW_POINTS : -1])


@pytest.mark.parametrize("count", [1, 2, 3])
def test_short_strands_have_a_finite_variance(count: int) -> None:
    assert (fit_variance(strand(straight(count)), SCATTER_M) > 0).all()
    assert np.isfinite(fit_variance(strand(straight(count), np.ones(count, dtype=bool)), SCATTER_M)).all()
