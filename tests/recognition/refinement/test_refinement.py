"""Strands fitted to the axes of the measured tubes."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.preprocessing.support_surface import SupportSurface
from recognition.refinement import refinement
from recognition.refinement.refinement import FittedStrand, refine
from recognition.strand import Strand

R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
NOISE = 0.05 * R


def strand(points: np.ndarray, closed: bool = False) -> Strand:
    return Strand(points, np.zeros(len(points), dtype=bool), closed)


def only(start: np.ndarray, surface: tuple[np.ndarray, np.ndarray], closed: bool = False) -> FittedStrand:
    (fitted,) = refine([strand(start, closed)], *surface, PARAMETERS).strands
    return fitted


def end_errors(fitted: FittedStrand, curve: np.ndarray) -> np.ndarray:
    return np.linalg.norm(fitted.points[[0, -1]] - curve[[0, -1]], axis=1)


def wave() -> np.ndarray:
    """An S of 190 mm, bent by 18 mm at the most (four times the string's radius), in links of 1 mm or so."""
    x = np.linspace(0, 0.15, 201)
    return np.column_stack([x, 0.02 * np.sin(2 * np.pi * x / 0.12), np.full_like(x, R)])


@pytest.mark.parametrize("offset", [(0, 0.3, 0), (0, 0, 0.3), (0, 0, -0.3), (0, -0.2, 0.2)])
def test_a_line_that_is_off_lands_on_the_axis_of_a_clean_tube(
    seen: Callable, straight: Callable, off_line: Callable, offset: tuple[float, float, float]
) -> None:
    axis = straight((0, 0, R), (0.15, 0, R))
    # A fiftieth of a radius, 0.08 mm, of noise.
    fitted = only(axis[::4] + R * np.array(offset), seen([axis], noise=0.02 * R))
    assert off_line(fitted.points, [axis]).max() < 0.03 * R
    assert fitted.measured_radius_m == pytest.approx(R, rel=0.02)
    # The measured radius does not contradict the expected one, so the expected one is used.
    assert fitted.radius_m == R
    # The percentile that an end is taken from is good for some tenths of a millimetre.
    assert end_errors(fitted, axis).max() < 0.1 * R
    assert not fitted.bridged.any()
    # Its profile is a circle but for the noise.
    assert fitted.roundness_error_m < 0.01 * R
    assert abs(fitted.squareness) < 0.05


@pytest.mark.parametrize("noise", [0.05, 0.1])
def test_bends_do_not_draw_it_inwards_nor_one_side_upwards(seen: Callable, off_line: Callable, noise: float) -> None:
    curve = wave()
    surface = seen([curve], noise=noise * R)
    fitted = only(curve[::4] + (0, 0, 0.3 * R), surface)
    # About 30 points support each point of the line: noise / sqrt(30) is 0.02 r; the largest of 60 is three times that.
    assert off_line(fitted.points, [curve]).max() < 0.03 * R + 0.6 * noise * R
    # No bias: the mean of all is ten times better.
    assert abs(float((fitted.points[:, 2] - R).mean())) < 0.02 * R
    assert end_errors(fitted, curve).max() < 0.3 * R


def test_the_end_of_a_bent_string_is_not_turned_straight(seen: Callable, arc: Callable) -> None:
    curve = arc(0.025, 0, 150)
    errors = []
    for seed in range(10):
        # A sparse and noisy surface, as four steep views from far away measure it.
        points, normals = seen([curve], noise=0.2 * R, seed=seed)
        fitted = only(curve[::4], (points[::4], normals[::4]))
        errors += [np.linalg.norm(curve - end, axis=1).min() for end in fitted.points[[0, -1]]]
    # With the full bending penalty up to the ends, it is 0.45 r.
    assert np.mean(errors) < 0.35 * R


@pytest.mark.parametrize("cut", [-1.5, -0.5, 0.5, 1.5])
def test_ends_are_neither_shortened_nor_run_past(seen: Callable, off_line: Callable, cut: float) -> None:
    curve = wave()
    surface = seen([curve], noise=NOISE)
    direction = curve[0] - curve[1]
    direction /= np.linalg.norm(direction)
    # The line comes 1.5 r short of the end, or runs 1.5 r past it straight on.
    inner = curve[arc_length(curve) > -cut * R]
    start = np.vstack([curve[0] + direction * R * cut, inner]) if cut > 0 else inner
    fitted = only(start, surface)
    assert end_errors(fitted, curve).max() < 0.3 * R
    assert arc_length(fitted.points)[-1] == pytest.approx(arc_length(curve)[-1], abs=0.3 * R)
    assert off_line(fitted.points, [curve]).max() < 0.1 * R


@pytest.mark.parametrize("share", [0.7, 0.9, 1.0, 1.1, 1.4])
def test_the_radius_is_measured(seen: Callable, straight: Callable, share: float) -> None:
    axis = straight((0, 0, share * R), (0.15, 0, share * R))
    fitted = only(axis[::4] + (0, 0.2 * R, 0.1 * R), seen([axis], radii=[share * R], noise=NOISE))
    assert fitted.measured_radius_m == pytest.approx(share * R, rel=0.02)
    # Within 12 % the expected radius is used.
    assert fitted.radius_m == (R if abs(share - 1) < 0.12 else fitted.measured_radius_m)


def test_a_string_that_hangs_between_others_keeps_its_radius(seen: Callable, straight: Callable) -> None:
    # It rises from the table to 1.5 radii above it. Half the height of the top of its lowest fifth is up to 1.15 R.
    axis = straight((0, 0, R), (0.15, 0, 2.5 * R))
    fitted = only(axis[::4], seen([axis], noise=NOISE))
    assert fitted.measured_radius_m == pytest.approx(R, rel=0.05)
    assert fitted.radius_m == R


@pytest.mark.parametrize("share", [0.7, 1.0, 1.4])
def test_the_radius_is_measured_on_a_string_that_rests_on_something_too(
    seen: Callable, straight: Callable, share: float
) -> None:
    axis = straight((0, 0, 0.03), (0.15, 0, 0.03))
    fitted = only(axis[::4] + (0, 0.2 * R, 0.1 * R), seen([axis], radii=[share * R], noise=NOISE))
    assert fitted.measured_radius_m == pytest.approx(share * R, rel=0.02)


def test_the_table_need_not_be_at_zero(seen: Callable, straight: Callable) -> None:
    axis = straight((0, 0, -0.2 + R), (0.15, 0, -0.2 + R))
    # Noise along the line of sight makes the fitted radius 5 % too large. The height of the top gives the radius.
    surface, normals = seen([axis], radii=[1.05 * R])
    surface = surface - (0, 0, 0.05 * R)
    found = refine([strand(axis[::4])], surface, normals, PARAMETERS, SupportSurface(-0.2))
    assert found.strands[0].measured_radius_m == pytest.approx(R, rel=0.005)


def test_strings_of_different_radii_are_each_fitted(seen: Callable, straight: Callable, off_line: Callable) -> None:
    axes = [straight((0, y, share * R), (0.1, y, share * R)) for y, share in ((0, 1.4), (0.04, 1.0), (0.08, 0.6))]
    surface, normals = seen(axes, radii=[1.4 * R, R, 0.6 * R], noise=NOISE)
    found = refine([strand(axis[::4]) for axis in axes], surface, normals, PARAMETERS)
    np.testing.assert_allclose([s.radius_m / R for s in found.strands], (1.4, 1.0, 0.6), rtol=0.02, atol=0)
    assert max(off_line(fitted.points, axes).max() for fitted in found.strands) < 0.08 * R


@pytest.mark.parametrize(("degrees", "gap"), [(30, 2.0), (60, 2.0), (90, 2.0), (60, 1.2), (90, 1.2)])
def test_strands_that_cross_keep_to_their_own_surface(
    seen: Callable, heap: Callable, off_line: Callable, degrees: float, gap: float
) -> None:
    under, over = heap((0, degrees), gap * R)
    surface, normals = seen([under, over], noise=NOISE)
    found = refine([strand(c[::4] + (0, 0, 0.1 * R)) for c in (under, over)], surface, normals, PARAMETERS)
    for fitted, curve in zip(found.strands, (under, over), strict=True):
        assert off_line(fitted.points, [curve]).max() < 0.1 * R
        assert end_errors(fitted, curve).max() < 0.3 * R
    below, above = found.strands
    assert not above.bridged.any()
    # Hidden from above is where all of the under strand's width is: |x| sin(a) + r cos(a) < r.
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    reach = R * (1 - cosine) / sine
    hidden = np.abs(below.points[:, 0]) < reach - 0.35 * R
    assert below.bridged[hidden].all()
    assert not below.bridged[np.abs(below.points[:, 0]) > reach + 0.7 * R].any()
    assert below.bridged.any()


def test_a_hairpin_and_a_ring_keep_their_length(
    seen: Callable, straight: Callable, arc: Callable, off_line: Callable
) -> None:
    there, back = straight((-0.06, -0.015, R), (0, -0.015, R)), straight((0, 0.015, R), (-0.06, 0.015, R))
    hairpin = np.vstack([there, arc(0.015, -90, 90)[1:], back[1:]])
    fitted = only(hairpin[::4] - (0.1 * R, 0, 0), seen([hairpin], noise=NOISE))
    assert off_line(fitted.points, [hairpin]).max() < 0.1 * R
    assert arc_length(fitted.points)[-1] == pytest.approx(0.12 + np.pi * 0.015, abs=0.3 * R)

    ring = arc(0.04, 0, 360)
    # Nodes come to lie 0.1 r inside.
    around = only(ring[:-1:4] * (0.99, 0.99, 1.05), seen([ring], noise=NOISE), closed=True)
    assert around.closed
    off = np.hypot(*around.points[:, :2].T) - 0.04
    assert np.abs(off).max() < 0.08 * R
    steps = np.linalg.norm(around.points - np.roll(around.points, 1, axis=0), axis=1)
    # Once round, also where it closes.
    assert steps.sum() == pytest.approx(2 * np.pi * 0.04, rel=0.005)
    assert steps.max() < 1.5 * np.median(steps)
    assert not around.bridged.any()


def test_points_are_evenly_spaced(seen: Callable) -> None:
    curve = wave()
    steps = np.linalg.norm(np.diff(only(curve[::11], seen([curve], noise=NOISE)).points, axis=0), axis=1)
    assert np.median(steps) == pytest.approx(0.7 * R, rel=0.05)
    assert steps.max() < 1.5 * 0.7 * R


def test_other_objects_and_flying_points_have_no_weight(seen: Callable, off_line: Callable) -> None:
    curve = wave()
    surface, normals = seen([curve], noise=NOISE)
    rng = np.random.default_rng(1)
    # One in ten flies, within a few radii of the string, with any normal; and there is a wall beside it.
    near = surface[rng.choice(len(surface), len(surface) // 10)] + rng.uniform(-3 * R, 3 * R, (len(surface) // 10, 3))
    any_way = rng.standard_normal(near.shape)
    any_way /= np.linalg.norm(any_way, axis=1, keepdims=True)
    wall = np.stack(np.meshgrid(np.arange(0, 0.15, 0.001), [0.026], np.arange(0, 0.03, 0.001)), axis=-1).reshape(-1, 3)
    everything = np.vstack([surface, near, wall])
    facing = np.vstack([normals, any_way, np.tile((0.0, -1.0, 0.0), (len(wall), 1))])
    found = refine([strand(curve[::4] + (0, 0, 0.2 * R))], everything, facing, PARAMETERS)
    (fitted,) = found.strands
    assert off_line(fitted.points, [curve]).max() < 0.12 * R
    assert fitted.measured_radius_m == pytest.approx(R, rel=0.04)
    strand_of_point = found.strand_of_point
    assert (strand_of_point[: len(surface)] == 0).mean() > 0.99
    assert (strand_of_point[-len(wall) :] == -1).mean() > 0.97
    # The scatter is that of the string, whatever lies beside it.
    assert found.scatter_m == pytest.approx(NOISE, rel=0.25)


def test_flying_pixels_at_one_rim_do_not_draw_it_aside(seen: Callable, straight: Callable) -> None:
    axis = straight((0, 0, R), (0.15, 0, R))
    surface, normals = seen([axis], noise=0.03 * R)
    left = normals[:, 1] > 0.7
    flying = left & (np.random.default_rng(2).random(len(left)) < 0.3)
    surface[flying] += 0.4 * R * normals[flying]
    fitted = only(axis[::4] + (0, 0.1 * R, 0), (surface, normals))
    # Three in ten on that flank are 0.4 r off, which by plain least squares comes to 0.06 r.
    assert abs(float(fitted.points[:, 1].mean())) < 0.02 * R
    assert fitted.measured_radius_m == pytest.approx(R, rel=0.02)


def test_a_square_bar_is_out_of_round(straight: Callable) -> None:
    axis = straight((0, 0, R), (0.1, 0, R))
    # Top and sides of a bar 2 r wide and high.
    across = np.linspace(-R, R, 15)
    top = [((x, y, 2 * R), (0, 0, 1)) for x in axis[:, 0] for y in across]
    sides = [((x, side * R, R + z), (0, side, 0)) for x in axis[:, 0] for z in across for side in (-1, 1)]
    surface, normals = (np.array(values, dtype=np.float64) for values in zip(*(top + sides), strict=True))
    # From 1 r at the middle of its sides to 1.41 r at its edges.
    fitted = only(axis[::4], (surface, normals))
    assert fitted.roundness_error_m > 0.05 * R
    assert fitted.squareness == pytest.approx(1.0, abs=0.1)
    assert fitted.squareness_sigma < 0.1


def test_nothing_to_fit_or_to_fit_to(seen: Callable, straight: Callable) -> None:
    axis = straight((0, 0, R), (0.1, 0, R))
    surface, normals = seen([axis])
    nothing = refine([], surface, normals, PARAMETERS)
    assert (nothing.strands, nothing.scatter_m) == ([], 0.0)
    np.testing.assert_array_equal(nothing.strand_of_point, np.full(len(surface), -1))
    assert refine([strand(axis[:1])], surface, normals, PARAMETERS).strands == []
    unseen = refine([strand(axis)], np.empty((0, 3)), np.empty((0, 3)), PARAMETERS)
    assert (unseen.strands, len(unseen.strand_of_point)) == ([], 0)


@pytest.mark.parametrize("count", [1, 3, 500])
def test_equal_points_give_finite_lines(straight: Callable, count: int) -> None:
    points, up = np.tile((0.05, 0.0, 2 * R), (count, 1)), np.tile((0.0, 0.0, 1.0), (count, 1))
    found = refine([strand(straight((0, 0, R), (0.1, 0, R))[::4])], points, up, PARAMETERS)
    for fitted in found.strands:
        assert np.isfinite(fitted.points).all()
        assert np.isfinite([fitted.radius_m, fitted.measured_radius_m, fitted.roundness_error_m]).all()
    assert np.isfinite(found.scatter_m)


@settings(deadline=None, max_examples=5, derandomize=True)
@given(turn=st.floats(0, 2 * np.pi), shift=st.tuples(*[st.floats(-1, 1)] * 3), scale=st.floats(0.3, 3))
def test_the_fit_moves_and_grows_with_the_string(
    seen: Callable, heap: Callable, turn: float, shift: tuple[float, ...], scale: float
) -> None:
    strands = heap((0, 70), 2 * R, half=0.04)
    surface, normals = seen(strands, noise=NOISE)
    before = refine([strand(c[::4]) for c in strands], surface, normals, PARAMETERS)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)])

    def moved(points: np.ndarray) -> np.ndarray:
        return scale * (points @ rotation.T + np.array(shift))

    lines = [strand(moved(c[::4])) for c in strands]
    parameters = ChainParameters.for_radius(scale * R)
    after = refine(lines, moved(surface), normals @ rotation.T, parameters, SupportSurface(scale * shift[2]))
    for one, other in zip(before.strands, after.strands, strict=True):
        # No voxels here: but for a point that rounding puts beyond a limit, the same sums.
        np.testing.assert_allclose(other.points, moved(one.points), rtol=0, atol=0.01 * scale * R)
        np.testing.assert_array_equal(other.bridged, one.bridged)
        assert other.measured_radius_m == pytest.approx(scale * one.measured_radius_m, rel=0.005)
    assert (after.strand_of_point == before.strand_of_point).mean() > 0.999


def test_the_order_of_the_surface_points_hardly_matters(seen: Callable, heap: Callable, off_line: Callable) -> None:
    strands = heap((0, 70), 2 * R, half=0.04)
    surface, normals = seen(strands, noise=NOISE)
    before = refine([strand(c[::4]) for c in strands], surface, normals, PARAMETERS)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(surface))
        after = refine([strand(c[::4]) for c in strands], surface[order], normals[order], PARAMETERS)
        for one, other in zip(before.strands, after.strands, strict=True):
            # The first fit uses a part of the points, so the last fit starts elsewhere and ends within its noise.
            assert arc_length(other.points)[-1] == pytest.approx(arc_length(one.points)[-1], abs=0.2 * R)
            assert off_line(other.points, [one.points]).max() < 0.1 * R
            assert other.measured_radius_m == pytest.approx(one.measured_radius_m, rel=0.02)


def test_the_height_that_resting_strings_lost_is_part_of_the_result(seen: Callable, straight: Callable) -> None:
    axis = straight((0, 0, R), (0.15, 0, R))
    surface, normals = seen([axis], noise=0.02 * R)
    for lost in (0.0, 0.2):
        lowered = surface - (0.0, 0.0, lost * R)
        found = refine([strand(axis[::4])], lowered, normals, PARAMETERS)
        assert found.lost_m == pytest.approx(lost * R, abs=0.02 * R)


def test_the_border_offset_is_part_of_the_result_if_there_are_ends(
    seen: Callable, straight: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refinement, "measure_border_offset", lambda *_: 0.3 * R)
    axis = straight((0, 0, R), (0.15, 0, R))
    surface, normals = seen([axis])
    assert refine([strand(axis[::4])], surface, normals, PARAMETERS).border_offset_m == 0.3 * R
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    ring = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), np.full_like(angle, R)])
    surface, normals = seen([ring])
    assert refine([strand(ring[::3], closed=True)], surface, normals, PARAMETERS).border_offset_m == 0.0
