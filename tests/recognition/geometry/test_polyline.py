"""Arc lengths and resampling of polylines, and the parabola of an end.

The parabola is known for lines and circles, and it moves as the line moves.
"""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recognition.geometry.polyline import (
    DISTURBED_RADII,
    MIN_BENT_RADII,
    arc_length,
    close_polyline,
    fit_end_parabola,
    points_at,
    resample,
    unit_vectors,
)

CORNERS = np.array([(0.0, 0.0, 0.0), (0.03, 0.0, 0.0), (0.03, 0.04, 0.0)])
R = 0.0042
LENGTH = 4 * R
"""Length of the fitted part, as in the callers."""
FIRST = np.array([0.1, -0.2, 0.3])
DIRECTION = np.array([2.0, -1.0, 2.0]) / 3

Points = NDArray[np.float64]

polylines = arrays(np.float64, st.tuples(st.integers(2, 12), st.sampled_from((2, 3))), elements=st.floats(-1, 1))


def test_unit_vectors_have_length_1_and_a_zero_vector_stays_zero() -> None:
    vectors = np.array([[(3.0, 0.0, 4.0), (0.0, 0.0, 0.0)], [(0.0, -2.0, 0.0), (0.0, 0.0, 1e-6)]])
    expected = [[(0.6, 0.0, 0.8), (0, 0, 0)], [(0, -1, 0), (0, 0, 1)]]
    np.testing.assert_allclose(unit_vectors(vectors), expected, rtol=0, atol=1e-15)


def test_arc_length_adds_up_the_links() -> None:
    np.testing.assert_allclose(arc_length(CORNERS), (0, 0.03, 0.07), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(arc_length(CORNERS[:1]), [0.0])
    np.testing.assert_allclose(arc_length(close_polyline(CORNERS, True)), (0, 0.03, 0.07, 0.12), rtol=0, atol=1e-15)
    assert close_polyline(CORNERS, False) is CORNERS


def test_points_lie_on_the_links_and_are_clipped_to_the_ends() -> None:
    points = points_at(CORNERS, np.array([-1.0, 0.0, 0.01, 0.05, 0.07, 9.0]))
    truth = [(0, 0, 0), (0, 0, 0), (0.01, 0, 0), (0.03, 0.02, 0), (0.03, 0.04, 0), (0.03, 0.04, 0)]
    np.testing.assert_allclose(points, truth, rtol=0, atol=1e-15)


@given(polylines, st.floats(0.01, 0.5))
def test_resampling_keeps_both_ends_and_the_largest_step(points: np.ndarray, step: float) -> None:
    found = resample(points, step)
    np.testing.assert_allclose(found[[0, -1]], points[[0, -1]], rtol=0, atol=1e-12)
    # Two points are one step apart along the polyline, and less in a straight line across a corner.
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() <= step * (1 + 1e-6)
    assert len(found) == max(np.ceil(arc_length(points)[-1] / step - 1e-9), 2) + 1


@given(polylines, st.floats(0, 1))
def test_the_point_at_the_arc_length_of_a_corner_is_the_corner(points: np.ndarray, share: float) -> None:
    corner = round(share * (len(points) - 1))
    np.testing.assert_allclose(points_at(points, arc_length(points)[[corner]])[0], points[corner], rtol=0, atol=1e-9)


def test_a_polyline_of_zero_length_is_its_point() -> None:
    np.testing.assert_array_equal(resample(np.ones((2, 3)), 0.1), np.ones((3, 3)))


def straight(s: Points) -> Points:
    """Return the points of a line from `FIRST` along `DIRECTION` at the arc lengths `s`."""
    return FIRST + s[:, None] * DIRECTION


def circle(radius: float, length: float, count: int) -> Points:
    """Return an arc from the origin along x that bends towards y."""
    angle = np.linspace(0.0, length / radius, count)
    return radius * np.column_stack([np.sin(angle), 1 - np.cos(angle), np.zeros(count)])


@pytest.mark.parametrize("count", [2, 3, 4, 5, 30])
@pytest.mark.parametrize("length", [0.3 * R, 2 * R, 4 * R, 20 * R])
def test_the_parabola_of_a_straight_line_is_exact_for_any_spacing(count: int, length: float) -> None:
    terms = fit_end_parabola(straight(length * np.linspace(0, 1, count) ** 1.5), LENGTH, R)
    np.testing.assert_allclose(terms[:2], [FIRST, DIRECTION], rtol=0, atol=1e-12)
    # The bend is per metre: rounding of 1e-16 m, divided by the square of some millimetres.
    np.testing.assert_allclose(terms[2], 0.0, rtol=0, atol=1e-9)


def test_the_parabola_of_a_parabola_is_exact() -> None:
    # The parabola is so flat that its arc length is x: 5e-6 radii high, and 1e-11 radii longer than x.
    x = np.linspace(0, LENGTH, 18)
    bend = 3e-7 / R
    terms = fit_end_parabola(FIRST + np.column_stack([x, np.zeros(18), bend * x**2]), LENGTH, R)
    np.testing.assert_allclose(terms[0], FIRST, rtol=0, atol=1e-9 * R)
    np.testing.assert_allclose(terms[1], (1, 0, 0), rtol=0, atol=1e-9)
    np.testing.assert_allclose(terms[2], (0, 0, bend), rtol=0, atol=1e-3 * bend)


@pytest.mark.parametrize("radius", [10 * R, 20 * R, 60 * R])
def test_the_parabola_of_a_circle_is_exact_to_the_third_order(radius: float) -> None:
    position, direction, bend = fit_end_parabola(circle(radius, LENGTH, 60), LENGTH, R)
    # A circle differs from the parabola by at most s^3 / 6 R^2 along it and s^4 / 24 R^3 across. The derivatives of the
    # best fit differ by a few times that, divided by s and by s^2.
    along, across = LENGTH**3 / (6 * radius**2), LENGTH**4 / (24 * radius**3)
    np.testing.assert_allclose(position, 0.0, rtol=0, atol=along)
    np.testing.assert_allclose(direction, (1, 0, 0), rtol=0, atol=4 * along / LENGTH)
    assert bend[1] == pytest.approx(1 / (2 * radius), abs=4 * across / LENGTH**2)


def test_only_the_first_part_is_fitted() -> None:
    bent = circle(20 * R, LENGTH, 20)
    terms = fit_end_parabola(bent, LENGTH, R)
    onward = bent[-1] + np.linspace(0.01, 0.1, 20)[:, None] * (0, 0, 1)
    np.testing.assert_array_equal(fit_end_parabola(np.vstack([bent, onward]), arc_length(bent)[-1], R), terms)


def test_a_short_line_or_one_of_few_points_shows_no_bend() -> None:
    short = circle(10 * R, 0.95 * MIN_BENT_RADII * R, 30)
    few = circle(10 * R, LENGTH, 4)
    for line in (short, few):
        np.testing.assert_array_equal(fit_end_parabola(line, LENGTH, R)[2], 0.0)
    assert fit_end_parabola(circle(10 * R, 1.05 * MIN_BENT_RADII * R, 30), LENGTH, R)[2, 1] > 0


def test_displaced_points_at_the_end_have_little_weight() -> None:
    line = straight(np.linspace(0, LENGTH, 17))
    aside = np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    line[arc_length(line) < DISTURBED_RADII * R] += 0.2 * R * aside
    position, direction, _ = fit_end_parabola(line, LENGTH, R)
    # Three points of seventeen are off by 0.2 r. With full weight they shift the end by 0.2 r and turn its direction by
    # 0.17 rad.
    assert abs((position - FIRST) @ aside) < 0.1 * R
    assert abs(direction @ aside) < 0.08


def test_few_points_all_have_the_same_weight() -> None:
    # Symmetric: the best line through all four is the x axis.
    zigzag = R * np.array([(0, 0.1, 0), (1, -0.1, 0), (2, -0.1, 0), (3, 0.1, 0)])
    np.testing.assert_allclose(fit_end_parabola(zigzag, LENGTH, R)[:, 1], 0.0, rtol=0, atol=1e-12)


def test_the_parabola_of_coincident_points_is_constant() -> None:
    for count in (2, 6):
        terms = fit_end_parabola(np.tile(FIRST, (count, 1)), LENGTH, R)
        np.testing.assert_allclose(terms, [FIRST, np.zeros(3), np.zeros(3)], rtol=0, atol=1e-15)


@st.composite
def lines(draw: st.DrawFn) -> Points:
    """Draw random lines in units of radii, with no arc length within rounding of a threshold."""
    steps = draw(arrays(np.float64, st.tuples(st.integers(1, 25), st.just(3)), elements=st.floats(-1, 1)))
    line = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    s = arc_length(line)
    # Exclude points that coincide but for rounding.
    assume(np.diff(s).min() > 1e-3)
    assume(np.abs(s[:, None] - (DISTURBED_RADII, MIN_BENT_RADII, LENGTH / R)).min() > 1e-6)
    return line


@given(lines(), st.integers(0, 2**32 - 1), st.floats(0.2, 5.0))
def test_the_parabola_moves_turns_and_scales_with_the_line(line: Points, seed: int, scale: float) -> None:
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    there = fit_end_parabola(line * R, LENGTH, R)
    moved = fit_end_parabola((line * R * scale) @ turn.T + FIRST, LENGTH * scale, R * scale)
    factors = np.array([scale, 1.0, 1 / scale])[:, None]
    expected = factors * there @ turn.T + np.array([FIRST, np.zeros(3), np.zeros(3)])
    # Rounding of coordinates of some 0.1 m, over lengths that may be a thousandth of a radius, squared.
    np.testing.assert_allclose(moved * [[1], [R], [R**2]], expected * [[1], [R], [R**2]], rtol=0, atol=1e-8)
