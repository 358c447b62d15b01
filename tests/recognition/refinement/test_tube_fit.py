"""Tube fit on exact tubes: the surface lies one radius from the lines."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from recognition.refinement.tube_fit import BEND_SIGMA_RADII, END_BEND_FACTOR, END_BEND_POINTS, N_BANDS, TubeFit

R = 0.0042
STEP = 0.7 * R


def line(start: tuple[float, float, float], end: tuple[float, float, float]) -> np.ndarray:
    a, b = np.array(start), np.array(end)
    return np.linspace(a, b, round(np.linalg.norm(b - a) / STEP) + 1)


def settled(fit: TubeFit, steps: int = 8, radius_sigma: float | None = None) -> TubeFit:
    assigned = fit.assign()
    for _ in range(steps):
        fit.step(assigned, radius_sigma)
        assigned = fit.update_assignment(assigned)
    return fit


def test_a_tube_about_its_own_line_has_no_residuals(tube: Callable, straight: Callable) -> None:
    surface, normals = tube(straight((0, 0, R), (0.06, 0, R)), R, 0.2, np.pi - 0.2)
    fit = TubeFit([line((0, 0, R), (0.06, 0, R))], R, surface, normals)
    assigned = fit.assign()
    assert len(np.unique(assigned.point)) == len(surface)
    np.testing.assert_allclose(assigned.residual, 0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(assigned.outward, normals[assigned.point], rtol=0, atol=1e-9)
    foot = fit.points[assigned.link, 0] + assigned.fraction * (
        fit.points[assigned.link + 1, 0] - fit.points[assigned.link, 0]
    )
    np.testing.assert_allclose(foot, surface[assigned.point, 0], rtol=0, atol=1e-12)


def test_each_point_of_a_crossing_goes_to_its_own_strand(seen: Callable, heap: Callable) -> None:
    under, over = heap((0, 60), 2 * R)
    surface, normals = seen([under, over])
    fit = TubeFit([under[::3], over[::3]], R, surface, normals)
    assigned = fit.assign()
    owner = np.array([np.linalg.norm(surface[:, None] - c, axis=2).min(axis=1) for c in (under, over)]).argmin(axis=0)
    # At 2 r the tubes touch at one point, which may belong to either.
    assert (fit.line_of_point[assigned.link] == owner[assigned.point]).mean() > 0.995
    assert len(assigned.point) > 0.99 * len(surface)


def test_surface_on_no_tube_or_with_another_normal_is_excluded(tube: Callable, straight: Callable) -> None:
    surface, normals = tube(straight((0, 0, R), (0.06, 0, R)), R, 0.2, np.pi - 0.2)
    lines = [line((0, 0, R), (0.06, 0, R))]
    assert len(TubeFit(lines, R, surface, -normals).assign().point) == 0
    # The surface of a strand that lies on top of this one.
    assert len(TubeFit(lines, R, surface + (0, 0, 2 * R), normals).assign().point) == 0
    assert len(TubeFit(lines, R, surface + (0, 0.05, 0), normals).assign().point) == 0
    short = TubeFit([line((0, 0, R), (0.042, 0, R))], R, surface, normals).assign()
    # A third of a radius beyond the end counts as beside it.
    assert surface[short.point, 0].max() == pytest.approx(0.043, abs=1e-9)


@pytest.mark.parametrize("offset", [(0, 0.3, 0), (0, 0, 0.3), (0, 0, -0.3), (0, -0.2, 0.2)])
def test_a_line_that_is_off_is_brought_onto_the_axis(
    tube: Callable, straight: Callable, offset: tuple[float, float, float]
) -> None:
    surface, normals = tube(straight((0, 0, R), (0.1, 0, R)), R, 0.2, np.pi - 0.2)
    start = line((0, 0, R), (0.1, 0, R))
    fit = settled(TubeFit([start + R * np.array(offset)], R, surface, normals))
    # Gauss-Newton on an exact tube: only the term that keeps points in position is left, 1e-3 of the data.
    np.testing.assert_allclose(fit.points[:, 1:], start[:, 1:], rtol=0, atol=0.005 * R)
    # No measurement shows where along the line the points are: they stay.
    np.testing.assert_allclose(fit.points[:, 0], start[:, 0], rtol=0, atol=0.02 * R)


@pytest.mark.parametrize("share", [0.8, 1.0, 1.2])
def test_radii_are_fitted_line_by_line(seen: Callable, straight: Callable, share: float) -> None:
    axes = [straight((0, 0, R * share), (0.08, 0, R * share)), straight((0, 0.04, R), (0.08, 0.04, R))]
    # A little noise, as the robust weights need: points exact on one line would make the other's look like outliers.
    surface, normals = seen(axes, radii=[share * R, R], noise=0.02 * R)
    lines = [line((0, 0, R), (0.08, 0, R)), line((0, 0.04, R), (0.08, 0.04, R))]
    fit = settled(TubeFit(lines, R, surface, normals), radius_sigma=0.3 * R)
    # 0.02 r of noise in a thousand points, and the tie weighs as one of them.
    np.testing.assert_allclose(fit.radii / R, (share, 1.0), rtol=0, atol=0.005)
    np.testing.assert_allclose(fit.lines[0][:, 2], share * R, rtol=0, atol=0.02 * R)
    untied = settled(TubeFit(lines, R, surface, normals))
    np.testing.assert_array_equal(untied.radii, R)


def test_support_is_where_the_surface_is(tube: Callable, straight: Callable) -> None:
    axis = straight((0, 0, R), (0.1, 0, R))
    tubes = [tube(axis[part], R, 0.2, np.pi - 0.2) for part in (slice(0, 41), slice(60, 101))]
    surface, normals = (np.vstack(parts) for parts in zip(*tubes, strict=True))
    fit = TubeFit([line((0, 0, R), (0.1, 0, R))], R, surface, normals)
    assigned = fit.assign()
    support = fit.support(assigned)
    # All weights of the surface, shared out among the points on either side.
    assert support.sum() == pytest.approx(assigned.weight.sum(), rel=1e-9)
    x = fit.points[:, 0]
    hidden = (x > 0.041 + STEP) & (x < 0.059 - STEP)
    assert hidden.sum() >= 3
    np.testing.assert_array_equal(support[hidden], 0)
    # A point stands for 2.94 mm of a surface of 24 points each mm.
    seen_ = (x > STEP) & (x < 0.1 - STEP) & (np.abs(x - 0.05) > 0.01 + STEP)
    np.testing.assert_allclose(support[seen_], 24 * STEP / 0.001, rtol=0.25)


def test_the_banded_normal_matrix_is_the_sparse_product(seen: Callable, heap: Callable) -> None:
    surface, normals = seen(list(heap((0, 60), 2 * R)), noise=0.05 * R)
    # Lines of different lengths, at an oblique direction, one of them with only two points.
    lines = [curve[::4] for curve in heap((7, 70), 2 * R)]
    fit = TubeFit([lines[0], lines[1][:9], line((0.2, 0, R), (0.2 + 0.7 * R, 0, R))], R, surface, normals)
    assigned = fit.assign()
    weight = np.random.default_rng(0).uniform(0, 1e9, len(assigned.point))
    J, D = np.zeros((len(assigned.point), len(fit.points), 3)), np.zeros((0, len(fit.points)))
    rows = np.arange(len(J))
    J[rows, assigned.link] = -(1 - assigned.fraction[:, None]) * assigned.outward
    J[rows, assigned.link + 1] = -assigned.fraction[:, None] * assigned.outward
    J = J.reshape(len(J), -1)
    for first, end in itertools.pairwise(fit.starts):
        inner = np.eye(len(fit.points))[first + 1 : end - 1]
        from_end = np.minimum(np.arange(1, len(inner) + 1), np.arange(len(inner), 0, -1))
        inner = inner / np.where(from_end <= END_BEND_POINTS, END_BEND_FACTOR, 1.0)[:, None]
        D = np.vstack([D, np.roll(inner, -1, axis=1) - 2 * inner + np.roll(inner, 1, axis=1)])
    bending = np.kron(D.T @ D, np.eye(3)) * (BEND_SIGMA_RADII * R) ** -2.0
    bands, gradient, border = fit._normal_equations(assigned, weight)
    A = J.T @ (weight[:, None] * J) + bending
    banded = sum(np.diag(bands[N_BANDS - k, k:], k) for k in range(N_BANDS + 1))
    np.testing.assert_allclose(banded, np.triu(A), rtol=1e-12, atol=1e-12 * A.max())
    expected = J.T @ (weight * assigned.residual) + bending @ fit.points.ravel()
    np.testing.assert_allclose(gradient, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(border, -(J.T @ weight), rtol=1e-12, atol=1e-12 * weight.sum())


def test_where_nothing_is_seen_the_line_stays_smooth(tube: Callable, arc: Callable) -> None:
    ring = arc(0.05, 0, 120)
    tubes = [tube(ring[part], R, 0.2, np.pi - 0.2) for part in (slice(0, 45), slice(60, len(ring)))]
    surface, normals = (np.vstack(parts) for parts in zip(*tubes, strict=True))
    start = ring[::3] + (0, 0, 0.2 * R)
    fit = settled(TubeFit([start], R, surface, normals))
    # The unseen 15 mm are neither left behind at 0.2 r nor do they run away.
    assert np.abs(np.linalg.norm(fit.points[:, :2], axis=1) - 0.05).max() < 0.1 * R
    assert np.abs(fit.points[:, 2] - R).max() < 0.1 * R


def test_lines_of_two_points_and_surfaces_of_one_are_accepted() -> None:
    fit = TubeFit([line((0, 0, R), (0.7 * R, 0, R))], R, np.array([(0.001, 0.0, 2.1 * R)]), np.array([(0.0, 0.0, 1.0)]))
    settled(fit, steps=4, radius_sigma=0.3 * R)
    assert np.isfinite(fit.points).all()
    assert np.isfinite(fit.radii).all()
    # One point above the line: it lies on the tube afterwards.
    assert fit.assign().residual == pytest.approx([0.0], abs=0.02 * R)


def test_a_tight_bend_is_kept_near_a_hidden_bend(tube: Callable, arc: Callable) -> None:
    # Half a circle with a radius of 2.5 r, of which the middle is hidden. The usual penalty makes the bend wider.
    axis = arc(2.5 * R, 0, 180)
    middle = len(axis) // 2
    seen = [tube(axis[part], R, 0.2, np.pi - 0.2) for part in (slice(0, middle - 8), slice(middle + 8, None))]
    surface, normals = (np.vstack(parts) for parts in zip(*seen, strict=True))
    step = max(round(STEP / np.linalg.norm(axis[1] - axis[0])), 1)
    errors = []
    for bends in (None, axis[middle - 8 : middle + 8]):
        fit = settled(TubeFit([axis[::step]], R, surface, normals, bends=bends))
        errors.append(float(np.abs(np.linalg.norm(fit.points[:, :2], axis=1) - 2.5 * R).max()))
    assert errors[1] < errors[0] / 3
    assert errors[1] < 0.1 * R
