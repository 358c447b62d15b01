"""Crossings of fitted chains: over and under by height, and how certain that is."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from recognition.assembly.fitted_crossings import find_fitted_crossings
from recognition.model.model import Chain, Crossing

R = 0.0042
SIGMA = 0.0004


def chain(number: int, points: np.ndarray, sigma: float = SIGMA, views: int = 5, closed: bool = False) -> Chain:
    n = len(points)
    return Chain(number, closed, R, points, np.full(n, sigma), np.full(n, views), ("free", "free"))


def towards(number: int, degrees: float, height: float, sigma: float = SIGMA, views: int = 5) -> Chain:
    """A straight chain through the origin, from 41 mm before it to 61 mm behind."""
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    return chain(number, np.linspace(-0.041, 0.061, 35)[:, None] * way + (0, 0, height), sigma, views)


def only(*chains: Chain) -> tuple[Crossing, list[str]]:
    (crossing,), ambiguities = find_fitted_crossings(chains)
    return crossing, ambiguities


@pytest.mark.parametrize("gap", [1.2, 2.0])
@pytest.mark.parametrize("degrees", [30, 60, 90, -30, -60])
def test_the_higher_strand_is_over(degrees: float, gap: float) -> None:
    for first, second in ((0.0, gap * R), (gap * R, 0.0)):
        crossing, ambiguities = only(towards(0, 0, R + first), towards(1, degrees, R + second))
        over = int(second > first)
        assert (crossing.over.chain, crossing.under.chain) == (over, 1 - over)
        assert crossing.over.s_m == pytest.approx(0.041, abs=1e-9)
        assert crossing.under.s_m == pytest.approx(0.041, abs=1e-9)
        assert crossing.gap_m == pytest.approx(gap * R, abs=1e-9)
        assert crossing.angle_rad == pytest.approx(abs(np.radians(degrees)), abs=1e-9)
        np.testing.assert_allclose(crossing.point, (0, 0, R + gap * R / 2), rtol=0, atol=1e-9)
        # Right-handed: over turned counterclockwise onto under is positive, seen from above.
        assert crossing.sign == np.sign(degrees) * (-1 if over else 1)
        # 5 mm between heights known to 0.6 mm together.
        assert crossing.confidence > 0.999999
        assert ambiguities == []


def test_the_confidence_weighs_the_gap_against_both_sigmas() -> None:
    gap = 0.7 * 2 * R
    crossing, ambiguities = only(towards(0, 0, R, sigma=0.003), towards(1, 80, R + gap, sigma=0.004))
    assert crossing.confidence == pytest.approx(ndtr(gap / 0.005), abs=1e-9)
    # 88 %: under nine in ten it is told.
    (told,) = ambiguities
    assert told.endswith("heights differ by 5.9 mm only; which is over is not certain")
    certain, none_told = only(towards(0, 0, R, sigma=0.001), towards(1, 80, R + gap, sigma=0.001))
    assert certain.confidence > 0.9999
    assert none_told == []


def test_strands_at_nearly_one_height_are_not_decided() -> None:
    # Strings don't go through one another: less than 0.3 of both radii says that a line is wrong, however sure it is.
    crossing, ambiguities = only(towards(0, 0, R, sigma=0.0001), towards(1, 80, R + 0.25 * 2 * R, sigma=0.0001))
    assert crossing.confidence <= 0.6
    assert len(ambiguities) == 1


def test_a_strand_that_was_seen_is_not_certainly_under_one_that_was_not() -> None:
    seen_over, _ = only(towards(0, 0, R, views=0), towards(1, 80, 3 * R, views=5))
    assert seen_over.confidence > 0.999999
    crossing, (told,) = only(towards(0, 0, R, views=5), towards(1, 80, 3 * R, views=0))
    assert crossing.over.chain == 1
    assert crossing.confidence <= 0.6
    assert "the upper one was not seen there" in told


def test_a_grazing_contact_is_no_crossing(straight: Callable) -> None:
    # Side by side at one height, the second's line sways over the first's by a tenth of a millimetre.
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    swaying = line + np.column_stack([np.zeros(len(line)), 0.0001 * np.cos(line[:, 0] * 300), np.full(len(line), 0.0)])
    inside = np.abs(swaying[:, 0] - 0.05) < 0.008
    swaying[~inside, 1] = 0.0003
    assert find_fitted_crossings([chain(0, line), chain(1, swaying)]) == ([], [])


def test_two_crossings_near_one_another_with_a_gap_in_height_are_two(straight: Callable) -> None:
    # A tight bend of the upper one comes over the lower one and goes back.
    lower = straight((-0.05, 0, R), (0.05, 0, R), 0.003)
    x = np.linspace(-0.03, 0.03, 41)
    upper = np.column_stack([x, 20 * x**2 - 0.0015, np.full_like(x, 3 * R)])
    crossings, _ = find_fitted_crossings([chain(0, lower), chain(1, upper)])
    assert [(c.over.chain, c.under.chain) for c in crossings] == [(1, 0), (1, 0)]
    assert abs(crossings[0].under.s_m - crossings[1].under.s_m) == pytest.approx(2 * np.sqrt(0.0015 / 20), abs=0.0005)
    assert {c.sign for c in crossings} == {1, -1}


@pytest.mark.parametrize("gap", [0.7, 1.1, 1.25])
def test_a_clasp_is_two_crossings(gap: float) -> None:
    # The first over the second and, 4 r on, under it: pressed flat, and yet not one contact.
    x = np.linspace(-0.03, 0.03, 61)
    lift = gap * R / 2 * np.clip(-x / (2 * R), -1, 1)
    y = 0.3 * (np.abs(x) - 2 * R)
    first, second = np.column_stack([x, y, 2 * R + lift]), np.column_stack([x, -y, 2 * R - lift])
    crossings, _ = find_fitted_crossings([chain(0, first), chain(1, second)])
    assert [(c.over.chain, c.under.chain) for c in crossings] == [(0, 1), (1, 0)]


@pytest.mark.parametrize("seam", [0, 20, 45, 59])
def test_a_ring_is_grazed_wherever_its_seam_is(straight: Callable, seam: int) -> None:
    angle = np.arange(60) / 60 * 2 * np.pi
    ring = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), np.full(60, R)])
    # The line cuts a fifth of a millimetre off the ring, at one height.
    line = straight((0.0398, -0.05, R), (0.0398, 0.05, R), 0.003)
    assert find_fitted_crossings([chain(0, np.roll(ring, seam, axis=0), closed=True), chain(1, line)]) == ([], [])


def test_three_on_one_another_cross_in_pairs() -> None:
    crossings, _ = find_fitted_crossings([towards(k, 60.0 * k, (1 + 2 * k) * R) for k in range(3)])
    assert {(c.over.chain, c.under.chain) for c in crossings} == {(1, 0), (2, 0), (2, 1)}
    assert [c.id for c in crossings] == [0, 1, 2]
    gaps = {(c.over.chain, c.under.chain): c.gap_m / R for c in crossings}
    assert gaps == pytest.approx({(1, 0): 2, (2, 0): 4, (2, 1): 2}, abs=1e-6)


def test_a_chain_crosses_itself_and_a_ring_is_crossed_twice(arc: Callable, straight: Callable) -> None:
    # A loop: in along x, round, and out over itself along y.
    loop = np.vstack(
        [straight((-0.06, 0, R), (0.03, 0, R)), arc(0.03, -90, 180, centre=(0.03, 0.03))[1:],
         straight((0, 0.03, R), (0, -0.06, R))[1:]]
    )  # fmt: skip
    after = np.arange(len(loop)) > len(loop) - 80
    loop[after, 2] = 3 * R
    crossing, _ = only(chain(0, loop))
    assert (crossing.over.chain, crossing.under.chain) == (0, 0)
    assert crossing.under.s_m == pytest.approx(0.06, abs=0.001)
    # 90 mm, three quarters of a circle of 30 mm, 30 mm, and the step up of 2 r with its link's length.
    step = np.hypot(0.001, 2 * R) - 0.001
    assert crossing.over.s_m == pytest.approx(0.12 + 1.5 * np.pi * 0.03 + step, abs=0.001)
    # Over runs to -y, under to +x: from over to under it turns to the left.
    assert crossing.sign == 1

    ring = chain(1, arc(0.04, 10, 368, z=3 * R), closed=True)
    crossings, _ = find_fitted_crossings([towards(0, 0, R), ring])
    assert [(c.over.chain, c.under.chain) for c in crossings] == [(1, 0), (1, 0)]
    assert {c.sign for c in crossings} == {1, -1}


def test_no_chains_no_crossings() -> None:
    assert find_fitted_crossings([]) == ([], [])
    assert find_fitted_crossings([towards(0, 0, R)]) == ([], [])


@settings(deadline=None, max_examples=40, derandomize=True)
@given(
    degrees=st.floats(10, 170),
    turn=st.floats(0, 360),
    place=st.tuples(*[st.floats(-1, 1)] * 3),
    scale=st.floats(0.2, 5),
    gap=st.floats(0.7, 3),
)
def test_directions_mirrors_motions_and_scales(
    degrees: float, turn: float, place: tuple[float, ...], scale: float, gap: float
) -> None:
    a, b = towards(0, turn, R), towards(1, turn + degrees, R + gap * 2 * R)

    def same(c: Chain, move: Callable[[np.ndarray], np.ndarray], size: float = 1.0) -> Chain:
        return Chain(c.id, c.closed, size * R, move(c.points), size * c.sigma_m, c.views, c.ends)

    crossing, _ = only(a, b)
    backwards, _ = only(same(a, lambda p: p[::-1]), same(b, lambda p: p[::-1]))
    one_backwards, _ = only(same(a, lambda p: p[::-1]), b)
    mirrored, _ = only(*(same(c, lambda p: p * (1, -1, 1)) for c in (a, b)))
    moved, _ = only(*(same(c, lambda p: scale * (p + np.array(place)), scale) for c in (a, b)))
    assert (backwards.sign, one_backwards.sign, mirrored.sign) == (crossing.sign, -crossing.sign, -crossing.sign)
    for other, size in ((backwards, 1.0), (one_backwards, 1.0), (mirrored, 1.0), (moved, scale)):
        assert (other.over.chain, other.under.chain) == (1, 0)
        assert other.gap_m == pytest.approx(size * crossing.gap_m, rel=1e-6)
        assert other.angle_rad == pytest.approx(crossing.angle_rad, abs=1e-6)
        assert other.confidence == pytest.approx(crossing.confidence, abs=1e-6)
    np.testing.assert_allclose(moved.point, scale * (crossing.point + np.array(place)), rtol=0, atol=1e-6)
    assert moved.over.s_m == pytest.approx(scale * crossing.over.s_m, rel=1e-6)
