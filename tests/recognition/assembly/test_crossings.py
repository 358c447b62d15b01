"""Crossings of strands and of fitted chains: position, over and under, sign and confidence."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from recognition.assembly.crossings import CrossingSet, find_crossings, find_fitted_crossings
from recognition.model.chains import MIN_CERTAIN_CONFIDENCE, Chain, Crossing
from recognition.model.findings import Finding, finding
from recognition.parameters import ChainParameters
from recognition.strand import Strand

NOTHING_SEEN = np.empty((0, 3))
R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)
SIGMA = 0.0004


def is_empty(found: CrossingSet) -> bool:
    return found.crossings == () and found.findings == ()


def chain(*corners_mm: tuple[float, float, float], step_mm: float = 4.0) -> Strand:
    """Points along the polyline through the corners, which are points of it too."""
    corners = np.array(corners_mm) / 1000
    points = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(round(np.linalg.norm(b - a) / (step_mm / 1000)), 1)
        points.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    everything = np.vstack(points)
    return Strand(everything, np.zeros(len(everything), dtype=bool))


def towards(degrees: float, z_mm: float, before_mm: float = 41.0, after_mm: float = 62.0) -> Strand:
    """A straight chain through the origin in that direction, at that height."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return chain((-before_mm * c, -before_mm * s, z_mm), (after_mm * c, after_mm * s, z_mm))


def turned(strand: Strand) -> Strand:
    return replace(strand, points=strand.points[::-1].copy())


def mirrored(strand: Strand) -> Strand:
    return replace(strand, points=strand.points * (1, -1, 1))


def moved(strand: Strand, *way_m: float) -> Strand:
    return replace(strand, points=strand.points + np.array(way_m))


def only(strands: list[Strand], surface: np.ndarray = NOTHING_SEEN) -> Crossing:
    (crossing,) = find_crossings(strands, surface, PARAMETERS).crossings
    return crossing


def between(strands: list[Strand]) -> Crossing:
    """The crossing of the first strand with the second."""
    crossings = find_crossings(strands, NOTHING_SEEN, PARAMETERS).crossings
    (crossing,) = (c for c in crossings if c.over.chain != c.under.chain)
    return crossing


def test_two_straight_chains_cross_where_they_do_by_hand() -> None:
    crossing = only([towards(0, 4.2, before_mm=40), towards(60, 12.6, before_mm=30)])
    assert (crossing.over.chain, crossing.under.chain) == (1, 0)
    # Intersections of straight lines: exact but for roundings of doubles.
    assert crossing.over.s_m == pytest.approx(0.030, abs=1e-12)
    assert crossing.under.s_m == pytest.approx(0.040, abs=1e-12)
    assert crossing.gap_m == pytest.approx(0.0084, abs=1e-12)
    assert crossing.angle_rad == pytest.approx(np.radians(60), abs=1e-9)
    np.testing.assert_allclose(crossing.point, (0, 0, 0.0084), rtol=0, atol=1e-12)
    # 8.4 mm between heights known to 0.5 mm each: twelve sigma.
    assert crossing.confidence > 0.999999


def test_the_angle_is_that_of_lines_and_not_of_directions() -> None:
    assert only([towards(0, 4.2), towards(150, 12.6)]).angle_rad == pytest.approx(np.radians(30), abs=1e-9)
    assert only([towards(0, 4.2), towards(90, 12.6)]).angle_rad == pytest.approx(np.pi / 2, abs=1e-9)


def test_a_right_handed_crossing_is_positive() -> None:
    # Over to the upper right, under to the upper left.
    over, under = towards(45, 12.6), towards(135, 4.2)
    assert only([over, under]).sign == 1
    assert only([under, over]).sign == 1


@settings(deadline=None, max_examples=50)
@given(st.floats(0, 360), st.floats(15, 165), st.booleans(), st.booleans())
def test_the_sign_follows_directions_and_mirror(degrees: float, apart: float, left: bool, first_over: bool) -> None:
    heights = (12.6, 4.2) if first_over else (4.2, 12.6)
    strands = [towards(degrees, heights[0]), towards(degrees + (apart if left else -apart), heights[1])]
    sign = between(strands).sign
    assert between([turned(s) for s in strands]).sign == sign
    assert between([turned(strands[0]), strands[1]]).sign == -sign
    assert between([strands[0], turned(strands[1])]).sign == -sign
    assert between([mirrored(s) for s in strands]).sign == -sign
    # With the other strand over, it is the other crossing.
    assert between([replace(s, points=s.points * (1, 1, -1)) for s in strands]).sign == -sign


def test_a_chain_that_crosses_itself_does_so_once() -> None:
    corners = ((-40, 0, 4), (40, 0, 4), (40, 40, 12), (0, 40, 12), (0, -40, 12))
    strand = chain(*corners)
    crossing = only([strand])
    climb = np.hypot(40, 8)
    assert (crossing.over.chain, crossing.under.chain) == (0, 0)
    assert crossing.under.s_m == pytest.approx(0.040, abs=1e-9)
    assert crossing.over.s_m == pytest.approx((80 + climb + 40 + 40) / 1000, abs=1e-9)
    # Over downwards, under to the right; a chain that crosses itself keeps its sign when it is reversed.
    assert crossing.sign == 1
    assert only([turned(strand)]).sign == 1
    assert only([mirrored(strand)]).sign == -1


@pytest.mark.parametrize(("before_a", "before_b"), [(40, 40), (40, 42), (42, 40)], ids=["both", "first", "second"])
def test_a_crossing_exactly_in_a_point_is_found_once(before_a: float, before_b: float) -> None:
    # Steps of 4 mm: with 40 mm before the crossing it falls in a point, with 42 mm in the middle of a link.
    a = chain(*((x, 0, 4) for x in np.arange(-before_a, 60, 4)))
    b = chain(*((0, y, 12) for y in np.arange(-before_b, 60, 4)))
    assert only([a, b]).under.s_m == pytest.approx(before_a / 1000, abs=1e-12)


def test_a_crossing_in_a_point_is_found_once_whatever_the_rounding() -> None:
    # 40 mm in steps of 4 mm: the crossing falls in a point of both, but for roundings that differ by direction.
    found = []
    for degrees in range(0, 360, 5):
        crossings = find_crossings(
            [towards(degrees, 4.2, 40, 60), towards(degrees + 70, 12.6, 40, 60)], NOTHING_SEEN, PARAMETERS
        ).crossings
        found.append(sum(crossing.over.chain != crossing.under.chain for crossing in crossings))
    assert set(found) == {1}


def test_a_straight_chain_does_not_cross_itself() -> None:
    # Links on one line are parallel but for rounding, also those that an end was lengthened by.
    for degrees in range(0, 360, 5):
        assert is_empty(find_crossings([towards(degrees, 4.2)], NOTHING_SEEN, PARAMETERS))


def test_chains_that_do_not_cross_have_no_crossing() -> None:
    parallel = [towards(0, 4.2), moved(towards(0, 4.2), 0.0, 0.01, 0.0)]
    short = [towards(0, 4.2), chain((0, 5, 12), (0, 50, 12))]
    corner = [chain((0, 0, 4), (40, 0, 4), (40, 40, 4))]
    for strands in (parallel, short, corner, []):
        assert is_empty(find_crossings(strands, NOTHING_SEEN, PARAMETERS))


def ring(radius_mm: float, z_mm: float, count: int = 60) -> Strand:
    # Half a step off, so that the closing link crosses the x axis.
    angle = (np.arange(count) + 0.5) / count * 2 * np.pi
    points = np.column_stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle), np.full(count, z_mm)]) / 1000
    return Strand(points, np.zeros(count, dtype=bool), closed=True)


def test_a_closed_chain_is_crossed_in_its_closing_link_too() -> None:
    crossings = find_crossings([ring(40, 4.2), towards(0, 12.6)], NOTHING_SEEN, PARAMETERS).crossings
    along_ring = sorted(crossing.under.s_m for crossing in crossings)
    perimeter = 60 * 2 * 0.04 * np.sin(np.pi / 60)
    # From the first point half round less half a step, and the whole way round less half a step.
    np.testing.assert_allclose(along_ring, perimeter * np.array([29.5, 59.5]) / 60, rtol=0, atol=1e-9)


def test_a_ring_does_not_cross_itself_where_it_closes() -> None:
    # Its first and last link share a point, which rounding puts on either.
    for count in range(30, 90):
        assert is_empty(find_crossings([ring(40, 4.2, count)], NOTHING_SEEN, PARAMETERS))


def test_crossings_are_numbered_and_found_between_all_chains() -> None:
    strands = [towards(0, 4.2), chain((-20, -30, 12), (-20, 30, 12)), chain((20, -30, 12), (20, 30, 12))]
    found = find_crossings(strands, NOTHING_SEEN, PARAMETERS)
    assert [crossing.id for crossing in found.crossings] == [0, 1]
    assert {(crossing.over.chain, crossing.under.chain) for crossing in found.crossings} == {(1, 0), (2, 0)}
    assert found.findings == ()


def test_heights_are_measured_on_the_surface(tube: Callable) -> None:
    """Averages lift the line of the under strand and lower that of the over strand; the tops show the heights."""
    low, high = towards(0, 4.2), towards(80, 12.6)
    surface = np.vstack([tube(s.points, R, 0, np.pi)[0] for s in (fine(low), fine(high))])
    flattened = [moved(low, 0.0, 0.0, 0.001), moved(high, 0.0, 0.0, -0.0015)]
    crossing = only(flattened, surface)
    assert (crossing.over.chain, crossing.under.chain) == (1, 0)
    # The 90th percentile of a ridge within r / 2 is 0.02 r below its top, on both strands alike.
    assert crossing.gap_m == pytest.approx(0.0084, abs=0.0002)
    assert crossing.point[2] == pytest.approx(0.0084, abs=0.0002)
    # Where nothing is seen, the chains' own heights count.
    assert only(flattened).gap_m == pytest.approx(0.0084 - 0.0025, abs=1e-12)


def fine(strand: Strand) -> Strand:
    """The same straight chain in steps of 0.5 mm."""
    count = round(np.linalg.norm(strand.points[-1] - strand.points[0]) / 0.0005)
    points = np.linspace(strand.points[0], strand.points[-1], count)
    return Strand(points, np.zeros(count, dtype=bool))


def assert_names_crossing(found: Finding, code: str, crossing: Crossing) -> None:
    """Check that a finding is a doubt about a crossing, with its chains, its position and its low confidence."""
    assert (found.code, found.severity, found.crossing) == (code, "doubt", crossing.id)
    assert set(found.chains) == {crossing.over.chain, crossing.under.chain}
    assert found.point_m == pytest.approx(crossing.point, abs=1e-12)
    assert (found.value, found.limit) == (crossing.confidence, MIN_CERTAIN_CONFIDENCE)
    assert crossing.confidence < MIN_CERTAIN_CONFIDENCE
    assert found.s_range_m is None, "it concerns both passes of the crossing"


def test_equal_heights_are_undecided() -> None:
    found = find_crossings([towards(0, 8.0), towards(70, 8.1)], NOTHING_SEEN, PARAMETERS)
    # 0.1 mm between heights known to 0.5 mm: 0.14 sigma of their difference.
    assert found.crossings[0].confidence == pytest.approx(0.556, abs=0.001)
    (undecided,) = found.findings
    assert_names_crossing(undecided, "crossing-undecided", found.crossings[0])
    assert undecided.message.startswith("crossing 0 at (0, 0, 8) mm: the heights of the strands differ by only 0.1 mm")
    assert only([towards(0, 8.0), towards(70, 8.0)]).confidence == 0.5


def fitted_chain(number: int, points: np.ndarray, sigma: float = SIGMA, views: int = 5, closed: bool = False) -> Chain:
    n = len(points)
    return Chain(number, closed, R, points, np.full(n, sigma), np.full(n, views), ("free", "free"))


def fitted_towards(number: int, degrees: float, height: float, sigma: float = SIGMA, views: int = 5) -> Chain:
    """A straight chain through the origin, from 41 mm before it to 61 mm behind."""
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    return fitted_chain(number, np.linspace(-0.041, 0.061, 35)[:, None] * way + (0, 0, height), sigma, views)


def only_fitted(*chains: Chain) -> tuple[Crossing, tuple[Finding, ...]]:
    found = find_fitted_crossings(chains)
    (crossing,) = found.crossings
    return crossing, found.findings


@pytest.mark.parametrize("gap", [1.2, 2.0])
@pytest.mark.parametrize("degrees", [30, 60, 90, -30, -60])
def test_the_higher_strand_is_over(degrees: float, gap: float) -> None:
    for first, second in ((0.0, gap * R), (gap * R, 0.0)):
        crossing, findings = only_fitted(fitted_towards(0, 0, R + first), fitted_towards(1, degrees, R + second))
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
        assert findings == ()


def test_the_confidence_weighs_the_gap_against_both_sigmas() -> None:
    gap = 0.7 * 2 * R
    crossing, findings = only_fitted(fitted_towards(0, 0, R, sigma=0.003), fitted_towards(1, 80, R + gap, sigma=0.004))
    assert crossing.confidence == pytest.approx(ndtr(gap / 0.005), abs=1e-9)
    # 88 %: reported, because it is below 90 %.
    (undecided,) = findings
    assert_names_crossing(undecided, "crossing-undecided", crossing)
    assert undecided.message.endswith("differ by only 5.9 mm; which strand is over is not certain")
    certain, no_findings = only_fitted(
        fitted_towards(0, 0, R, sigma=0.001), fitted_towards(1, 80, R + gap, sigma=0.001)
    )
    assert certain.confidence > 0.9999
    assert no_findings == ()


def test_strands_at_nearly_one_height_are_not_decided() -> None:
    # Strings do not pass through each other: a gap below 0.3 of both radii means that a line is wrong.
    crossing, findings = only_fitted(
        fitted_towards(0, 0, R, sigma=0.0001), fitted_towards(1, 80, R + 0.25 * 2 * R, sigma=0.0001)
    )
    assert crossing.confidence <= 0.6
    (undecided,) = findings
    assert_names_crossing(undecided, "crossing-undecided", crossing)


def test_a_strand_that_was_seen_is_not_certainly_under_one_that_was_not() -> None:
    seen_over, _ = only_fitted(fitted_towards(0, 0, R, views=0), fitted_towards(1, 80, 3 * R, views=5))
    assert seen_over.confidence > 0.999999
    crossing, (unseen,) = only_fitted(fitted_towards(0, 0, R, views=5), fitted_towards(1, 80, 3 * R, views=0))
    assert crossing.over.chain == 1
    assert crossing.confidence <= 0.6
    assert_names_crossing(unseen, "upper-strand-unseen", crossing)
    assert "the upper strand was not seen there" in unseen.message


@pytest.mark.parametrize(("uncertain", "expected"), [((0, 1), 0.53), ((0,), 1.0), ((1,), 1.0)])
def test_a_crossing_of_chains_that_may_be_connected_differently_is_undecided(
    uncertain: tuple[int, ...], expected: float
) -> None:
    chains = [fitted_towards(0, 0, R), fitted_towards(1, 90, 3 * R)]
    margins = {0: 0.25, 1: 0.12}

    def doubts(middle_m: float) -> list[Finding]:
        part = (middle_m - 0.01, middle_m + 0.01)
        return [
            finding("connection-uncertain", "?", chains=(k,), s_range_m=part, value=margins[k], limit=2.0)
            for k in uncertain
        ]

    at = chains[0].length_m * 41 / 103
    found = find_fitted_crossings(chains, doubts(at))
    # Odds of exp(0.25 / 2) for the more certain one of both connections.
    assert found.crossings[0].confidence == pytest.approx(expected, abs=0.005)
    assert [f.code for f in found.findings] == (["crossing-undecided"] if expected < 1 else [])
    assert all("connected differently" in f.message for f in found.findings)
    elsewhere = find_fitted_crossings(chains, doubts(at + 0.03))
    assert elsewhere.crossings[0].confidence > 0.999


def test_a_grazing_contact_is_no_crossing(straight: Callable) -> None:
    # Side by side at one height, the second's line sways over the first's by a tenth of a millimetre.
    line = straight((0, 0, R), (0.1, 0, R), 0.003)
    swaying = line + np.column_stack([np.zeros(len(line)), 0.0001 * np.cos(line[:, 0] * 300), np.full(len(line), 0.0)])
    inside = np.abs(swaying[:, 0] - 0.05) < 0.008
    swaying[~inside, 1] = 0.0003
    assert is_empty(find_fitted_crossings([fitted_chain(0, line), fitted_chain(1, swaying)]))


def test_two_flat_crossings_at_large_angles_are_no_contact_but_undecided(straight: Callable) -> None:
    # The second crosses the first at 45 degrees, turns within 4 r and comes back: heights alike, and yet two crossings.
    line = straight((-0.05, 0, R), (0.05, 0, R), 0.003)
    x = np.linspace(-0.03, 0.03, 61)
    turning = np.column_stack([x, np.abs(x) - 2 * R, np.full_like(x, 1.1 * R)])
    found = find_fitted_crossings([fitted_chain(0, line), fitted_chain(1, turning)])
    assert [c.point[0] for c in found.crossings] == pytest.approx([-2 * R, 2 * R], abs=1e-4)
    assert all(c.confidence <= 0.6 for c in found.crossings)
    assert [finding.code for finding in found.findings] == 2 * ["crossing-undecided"]


def test_two_crossings_near_one_another_with_a_gap_in_height_are_two(straight: Callable) -> None:
    # A tight bend of the upper one comes over the lower one and goes back.
    lower = straight((-0.05, 0, R), (0.05, 0, R), 0.003)
    x = np.linspace(-0.03, 0.03, 41)
    upper = np.column_stack([x, 20 * x**2 - 0.0015, np.full_like(x, 3 * R)])
    crossings = find_fitted_crossings([fitted_chain(0, lower), fitted_chain(1, upper)]).crossings
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
    crossings = find_fitted_crossings([fitted_chain(0, first), fitted_chain(1, second)]).crossings
    assert [(c.over.chain, c.under.chain) for c in crossings] == [(0, 1), (1, 0)]


@pytest.mark.parametrize("seam", [0, 20, 45, 59])
def test_a_ring_is_grazed_wherever_its_seam_is(straight: Callable, seam: int) -> None:
    angle = np.arange(60) / 60 * 2 * np.pi
    ring = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), np.full(60, R)])
    # The line cuts a fifth of a millimetre off the ring, at one height.
    line = straight((0.0398, -0.05, R), (0.0398, 0.05, R), 0.003)
    assert is_empty(
        find_fitted_crossings([fitted_chain(0, np.roll(ring, seam, axis=0), closed=True), fitted_chain(1, line)])
    )


def test_three_on_one_another_cross_in_pairs() -> None:
    crossings = find_fitted_crossings([fitted_towards(k, 60.0 * k, (1 + 2 * k) * R) for k in range(3)]).crossings
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
    crossing, _ = only_fitted(fitted_chain(0, loop))
    assert (crossing.over.chain, crossing.under.chain) == (0, 0)
    assert crossing.under.s_m == pytest.approx(0.06, abs=0.001)
    # 90 mm, three quarters of a circle of 30 mm, 30 mm, and the step up of 2 r with its link's length.
    step = np.hypot(0.001, 2 * R) - 0.001
    assert crossing.over.s_m == pytest.approx(0.12 + 1.5 * np.pi * 0.03 + step, abs=0.001)
    # Over runs to -y, under to +x: from over to under it turns to the left.
    assert crossing.sign == 1

    ring = fitted_chain(1, arc(0.04, 10, 368, z=3 * R), closed=True)
    crossings = find_fitted_crossings([fitted_towards(0, 0, R), ring]).crossings
    assert [(c.over.chain, c.under.chain) for c in crossings] == [(1, 0), (1, 0)]
    assert {c.sign for c in crossings} == {1, -1}


def test_no_chains_no_crossings() -> None:
    assert is_empty(find_fitted_crossings([]))
    assert is_empty(find_fitted_crossings([fitted_towards(0, 0, R)]))


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
    a, b = fitted_towards(0, turn, R), fitted_towards(1, turn + degrees, R + gap * 2 * R)

    def same(c: Chain, move: Callable[[np.ndarray], np.ndarray], size: float = 1.0) -> Chain:
        return Chain(c.id, c.closed, size * R, move(c.points), size * c.sigma_m, c.views, c.ends)

    crossing, _ = only_fitted(a, b)
    backwards, _ = only_fitted(same(a, lambda p: p[::-1]), same(b, lambda p: p[::-1]))
    one_backwards, _ = only_fitted(same(a, lambda p: p[::-1]), b)
    mirrored, _ = only_fitted(*(same(c, lambda p: p * (1, -1, 1)) for c in (a, b)))
    moved, _ = only_fitted(*(same(c, lambda p: scale * (p + np.array(place)), scale) for c in (a, b)))
    assert (backwards.sign, one_backwards.sign, mirrored.sign) == (crossing.sign, -crossing.sign, -crossing.sign)
    for other, size in ((backwards, 1.0), (one_backwards, 1.0), (mirrored, 1.0), (moved, scale)):
        assert (other.over.chain, other.under.chain) == (1, 0)
        assert other.gap_m == pytest.approx(size * crossing.gap_m, rel=1e-6)
        assert other.angle_rad == pytest.approx(crossing.angle_rad, abs=1e-6)
        assert other.confidence == pytest.approx(crossing.confidence, abs=1e-6)
    np.testing.assert_allclose(moved.point, scale * (crossing.point + np.array(place)), rtol=0, atol=1e-6)
    assert moved.over.s_m == pytest.approx(scale * crossing.over.s_m, rel=1e-6)
