"""Crossings of hand-made chains: where they are, which strand is over, and of what sign."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.assembly.crossings import find_crossings
from recognition.model.model import Crossing
from recognition.parameters import ChainParameters
from recognition.strand import Strand

NOTHING_SEEN = np.empty((0, 3))
R = 0.0042
PARAMETERS = ChainParameters.for_radius(R)


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
    (crossing,), _ = find_crossings(strands, surface, PARAMETERS)
    return crossing


def between(strands: list[Strand]) -> Crossing:
    """The crossing of the first strand with the second."""
    crossings, _ = find_crossings(strands, NOTHING_SEEN, PARAMETERS)
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
        crossings, _ = find_crossings(
            [towards(degrees, 4.2, 40, 60), towards(degrees + 70, 12.6, 40, 60)], NOTHING_SEEN, PARAMETERS
        )
        found.append(sum(crossing.over.chain != crossing.under.chain for crossing in crossings))
    assert set(found) == {1}


def test_a_straight_chain_does_not_cross_itself() -> None:
    # Links on one line are parallel but for rounding, also those that an end was lengthened by.
    for degrees in range(0, 360, 5):
        assert find_crossings([towards(degrees, 4.2)], NOTHING_SEEN, PARAMETERS) == ([], [])


def test_chains_that_do_not_cross_have_no_crossing() -> None:
    parallel = [towards(0, 4.2), moved(towards(0, 4.2), 0.0, 0.01, 0.0)]
    short = [towards(0, 4.2), chain((0, 5, 12), (0, 50, 12))]
    corner = [chain((0, 0, 4), (40, 0, 4), (40, 40, 4))]
    for strands in (parallel, short, corner, []):
        assert find_crossings(strands, NOTHING_SEEN, PARAMETERS) == ([], [])


def ring(radius_mm: float, z_mm: float, count: int = 60) -> Strand:
    # Half a step off, so that the closing link crosses the x axis.
    angle = (np.arange(count) + 0.5) / count * 2 * np.pi
    points = np.column_stack([radius_mm * np.cos(angle), radius_mm * np.sin(angle), np.full(count, z_mm)]) / 1000
    return Strand(points, np.zeros(count, dtype=bool), closed=True)


def test_a_closed_chain_is_crossed_in_its_closing_link_too() -> None:
    crossings, _ = find_crossings([ring(40, 4.2), towards(0, 12.6)], NOTHING_SEEN, PARAMETERS)
    along_ring = sorted(crossing.under.s_m for crossing in crossings)
    perimeter = 60 * 2 * 0.04 * np.sin(np.pi / 60)
    # From the first point half round less half a step, and the whole way round less half a step.
    np.testing.assert_allclose(along_ring, perimeter * np.array([29.5, 59.5]) / 60, rtol=0, atol=1e-9)


def test_a_ring_does_not_cross_itself_where_it_closes() -> None:
    # Its first and last link share a point, which rounding puts on either.
    for count in range(30, 90):
        assert find_crossings([ring(40, 4.2, count)], NOTHING_SEEN, PARAMETERS) == ([], [])


def test_crossings_are_numbered_and_found_between_all_chains() -> None:
    strands = [towards(0, 4.2), chain((-20, -30, 12), (-20, 30, 12)), chain((20, -30, 12), (20, 30, 12))]
    crossings, ambiguities = find_crossings(strands, NOTHING_SEEN, PARAMETERS)
    assert [crossing.id for crossing in crossings] == [0, 1]
    assert {(crossing.over.chain, crossing.under.chain) for crossing in crossings} == {(1, 0), (2, 0)}
    assert ambiguities == []


def test_heights_are_measured_on_the_surface(tube: Callable) -> None:
    """Averages lift the under strand's line and lower the over one's; the tops tell how they lie."""
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


def test_equal_heights_are_said_to_be_undecided() -> None:
    crossings, ambiguities = find_crossings([towards(0, 8.0), towards(70, 8.1)], NOTHING_SEEN, PARAMETERS)
    # 0.1 mm between heights known to 0.5 mm: 0.14 sigma of their difference.
    assert crossings[0].confidence == pytest.approx(0.556, abs=0.001)
    (said,) = ambiguities
    assert said.startswith("crossing 0 at (0, 0, 8) mm: the strands' heights differ by 0.1 mm only")
    assert find_crossings([towards(0, 8.0), towards(70, 8.0)], NOTHING_SEEN, PARAMETERS)[0][0].confidence == 0.5
