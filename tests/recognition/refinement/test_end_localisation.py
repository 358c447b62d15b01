"""Lines extended or cut to where the surface about them ends."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from recognition.refinement.end_localisation import extend_below_strand, localise_end

R = 0.0042
STEP = 0.7 * R
NOISE = 0.05 * R


def line_from(x: float, to: float = 0.1) -> np.ndarray:
    points = np.arange(x, to, STEP)
    return np.column_stack([points, np.zeros_like(points), np.full_like(points, R)])


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("start", [-1.5, -0.8, -0.3, 0.0, 0.4, 1.0, 2.0])
def test_a_straight_line_ends_where_the_string_does(
    seen: Callable, straight: Callable, off_line: Callable, start: float, noise: float
) -> None:
    axis = straight((0, 0, R), (0.1, 0, R))
    surface, normals = seen([axis], noise=noise * R)
    ended = localise_end(line_from(start * R), surface, normals, R)
    # The end is the 95th percentile of the surface of the last 2 r; its points are 1 mm (0.24 r) apart.
    assert abs(ended[0, 0]) < 0.25 * R
    assert off_line(ended, [axis]).max() < 0.25 * R
    # The rest of the line is what it was, and the spacing about the same.
    np.testing.assert_array_equal(ended[-10:], line_from(start * R)[-10:])
    steps = np.linalg.norm(np.diff(ended, axis=0), axis=1)
    assert steps.min() > 0.3 * STEP
    assert steps.max() < 1.6 * STEP


@pytest.mark.parametrize("beyond", [-1.5, -0.7, 0.0, 0.7])
@pytest.mark.parametrize("radius", [0.03, 0.06])
def test_a_bend_is_extrapolated(seen: Callable, arc: Callable, radius: float, beyond: float) -> None:
    string = arc(radius, 0, 100)
    surface, normals = seen([string], noise=NOISE)
    first = -np.degrees(beyond * R / radius)
    whole = np.radians(np.arange(first, 100, np.degrees(STEP / radius)))
    line = np.column_stack([radius * np.cos(whole), radius * np.sin(whole), np.full_like(whole, R)])
    ended = localise_end(line, surface, normals, R)
    assert np.linalg.norm(ended[0] - string[0]) < 0.3 * R


def test_it_ends_before_another_string_that_lies_across(seen: Callable, straight: Callable) -> None:
    # It butts against the other's side: their surfaces are connected, but their normals differ.
    ending = straight((0, 0, R), (0.1, 0, R))
    across = straight((-1.05 * R, -0.04, R), (-1.05 * R, 0.04, R))
    surface, normals = seen([ending, across], noise=NOISE)
    for start in (-0.5, 0.0, 1.5):
        assert localise_end(line_from(start * R), surface, normals, R)[0, 0] == pytest.approx(0.0, abs=0.3 * R)


def test_it_does_not_leap_over_a_hole_to_the_next_string(seen: Callable, straight: Callable) -> None:
    strings = [straight((0, 0, R), (0.1, 0, R)), straight((-0.05, 0, R), (-R, 0, R))]
    surface, normals = seen(strings, noise=NOISE)
    # A radius of bare table, in line.
    assert localise_end(line_from(R), surface, normals, R)[0, 0] == pytest.approx(0.0, abs=0.25 * R)


def test_it_ends_under_a_strand_that_hides_it(seen: Callable, straight: Callable) -> None:
    under = straight((-0.05, 0, R), (0.1, 0, R))
    over = straight((0, -0.05, 3 * R), (0, 0.05, 3 * R))
    surface, normals = seen([under, over], noise=NOISE)
    # The camera loses it at x = r; the strand above does not lie about its axis.
    assert localise_end(line_from(2 * R), surface, normals, R)[0, 0] == pytest.approx(R, abs=0.25 * R)


def test_a_line_with_no_surface_about_it_stays(seen: Callable, straight: Callable) -> None:
    surface, normals = seen([straight((0, 0.05, R), (0.1, 0.05, R))])
    np.testing.assert_array_equal(localise_end(line_from(0), surface, normals, R), line_from(0))
    np.testing.assert_array_equal(localise_end(line_from(0), np.empty((0, 3)), np.empty((0, 3)), R), line_from(0))


def test_lines_of_a_few_points_are_accepted(seen: Callable, straight: Callable) -> None:
    surface, normals = seen([straight((0, 0, R), (0.012, 0, R))], noise=NOISE)
    for count in (2, 3, 4):
        ended = localise_end(line_from(0.5 * R)[:count], surface, normals, R)
        assert ended[0, 0] == pytest.approx(0.0, abs=0.3 * R)
        assert np.isfinite(ended).all()


def below(end: float, straight: Callable, height: float = 3 * R) -> tuple[np.ndarray, np.ndarray]:
    """Return a string along x that ends at `end`, and a strand across x = 0 at a height."""
    return straight((end, 0, R), (0.1, 0, R)), straight((0, -0.05, height), (0, 0.05, height))


def own_surface(seen: Callable, strings: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface without that of the second string, whose top is higher than that of the first."""
    surface, normals = seen(strings, noise=NOISE)
    is_own = surface[:, 2] < 2.3 * R
    return surface[is_own], normals[is_own]


@pytest.mark.parametrize("end", [-1.8, -2.5, -3.5])
def test_an_end_beyond_a_strand_above_is_found(seen: Callable, straight: Callable, end: float) -> None:
    strings = below(end * R, straight)
    surface, normals = own_surface(seen, strings)
    line = line_from(1.1 * R)
    extended = extend_below_strand(line, surface, normals, strings[1], R)
    assert extended[0, 0] == pytest.approx(end * R, abs=0.3 * R)
    assert np.abs(extended[:, 1]).max() < 0.3 * R
    np.testing.assert_array_equal(extended[-10:], line[-10:])


def test_an_end_below_a_strand_stays(seen: Callable, straight: Callable) -> None:
    strings = below(-0.5 * R, straight)
    line = line_from(1.1 * R)
    np.testing.assert_array_equal(extend_below_strand(line, *own_surface(seen, strings), strings[1], R), line)


def test_surface_without_a_strand_above_does_not_extend_the_end(seen: Callable, straight: Callable) -> None:
    line = line_from(1.1 * R)
    beyond = own_surface(seen, below(-3 * R, straight))
    # Without another strand, below the strand, and too far before it.
    for others in (
        np.empty((0, 3)),
        straight((0, -0.05, R), (0, 0.05, R)),
        straight((-4 * R, -0.05, 3 * R), (-4 * R, 0.05, 3 * R)),
    ):
        np.testing.assert_array_equal(extend_below_strand(line, *beyond, others, R), line)
