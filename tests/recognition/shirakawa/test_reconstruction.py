"""Which ends of segments belong together (section III.E), on hand-made strands with r_f = 20 mm and r_cf = 35 mm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.parameters import ChainParameters
from recognition.shirakawa.reconstruction import (
    connect_across_gaps,
    connect_at_intersections,
    inner_products,
    reconnect_close_ends,
    reconstruct,
    straightest_pairs,
)
from recognition.strand import End, Strand, strand_ends

NO_CENTRES = np.empty((0, 3))
PARAMETERS = ChainParameters.for_radius(0.01)
Position = tuple[float, float]


def straight(start_mm: Position, end_mm: Position, z_mm: float = 0.0) -> np.ndarray:
    """Return points about 10 mm apart from one position to the other."""
    a, b = np.array([*start_mm, z_mm]) / 1000, np.array([*end_mm, z_mm]) / 1000
    return np.linspace(a, b, round(np.linalg.norm(b - a) / 0.01) + 1)


def strand(start_mm: Position, end_mm: Position, z_mm: float = 0.0) -> Strand:
    points = straight(start_mm, end_mm, z_mm)
    return Strand(points, np.zeros(len(points), dtype=bool))


def arm(degrees: float, inner_mm: float = 33.0, outer_mm: float = 103.0) -> Strand:
    """A strand from an intersection at the origin outwards in that direction."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return strand((inner_mm * c, inner_mm * s), (outer_mm * c, outer_mm * s))


def spans(strands: list[Strand]) -> set[frozenset[tuple[int, int]]]:
    """For each strand the whole millimetres of its two ends, whichever way it runs."""
    return {frozenset((round(p[0] * 1000), round(p[1] * 1000)) for p in (s.points[0], s.points[-1])) for s in strands}


def test_the_directions_of_ends_point_outwards() -> None:
    ends = strand_ends([strand((0, 0), (50, 0))], PARAMETERS)
    assert [end.at_start for end in ends] == [True, False]
    np.testing.assert_allclose([end.direction for end in ends], [(-1, 0, 0), (1, 0, 0)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(inner_products(ends), [[1, -1], [-1, 1]], rtol=0, atol=1e-15)


def test_a_direction_is_taken_over_r_f_and_not_from_the_last_link() -> None:
    bent = np.array([(0, 0, 0), (11, 0, 0), (22, 0, 0), (33, 0, 0), (33, 11, 0)]) / 1000
    last = strand_ends([Strand(bent, np.zeros(5, dtype=bool))], PARAMETERS)[1]
    # From the first point at least 20 mm back along the strand, (22, 0), to its end at (33, 11).
    np.testing.assert_allclose(last.direction, np.array([1, 1, 0]) / np.sqrt(2), rtol=0, atol=1e-15)


def test_closed_strands_have_no_ends_and_a_point_has_no_direction() -> None:
    points = straight((0, 0), (50, 0))
    assert strand_ends([Strand(points, np.zeros(6, dtype=bool), closed=True)], PARAMETERS) == []
    alone = strand_ends([Strand(np.zeros((1, 3)), np.zeros(1, dtype=bool))], PARAMETERS)
    assert [end.direction.tolist() for end in alone] == [[0, 0, 0], [0, 0, 0]]


def test_close_ends_are_reconnected() -> None:
    joined = reconnect_close_ends([strand((0, 0), (50, 0)), strand((69, 0), (120, 0))], NO_CENTRES, PARAMETERS)
    assert spans(joined) == {frozenset({(0, 0), (120, 0)})}


def test_ends_r_f_apart_stay_apart() -> None:
    strands = [strand((0, 0), (50, 0)), strand((71, 0), (120, 0))]
    assert len(reconnect_close_ends(strands, NO_CENTRES, PARAMETERS)) == 2


def test_of_several_close_ends_the_closest_are_joined() -> None:
    strands = [strand((0, 0), (50, 0)), strand((68, 0), (120, 0)), strand((62, 4), (110, 60))]
    joined = reconnect_close_ends(strands, NO_CENTRES, PARAMETERS)
    assert spans(joined) == {frozenset({(0, 0), (110, 60)}), frozenset({(68, 0), (120, 0)})}


def test_parallel_ends_side_by_side_stay_apart() -> None:
    strands = [strand((0, 0), (50, 0)), strand((0, 15), (50, 15))]
    assert spans(reconnect_close_ends(strands, NO_CENTRES, PARAMETERS)) == spans(strands)


def test_strands_do_not_fold_back() -> None:
    # The second turns back at 100 degrees to the first: a string of this radius can't do so within 15 mm.
    c, s = np.cos(np.radians(100)), np.sin(np.radians(100))
    strands = [strand((0, 0), (50, 0)), strand((62, 5), (62 + 60 * c, 5 + 60 * s))]
    assert len(reconnect_close_ends(strands, NO_CENTRES, PARAMETERS)) == 2


def test_a_single_point_between_two_ends_joins_both() -> None:
    point = Strand(np.array([[0.062, 0.0, 0.0]]), np.zeros(1, dtype=bool))
    joined = reconnect_close_ends([strand((0, 0), (50, 0)), point, strand((74, 0), (120, 0))], NO_CENTRES, PARAMETERS)
    assert spans(joined) == {frozenset({(0, 0), (120, 0)})}


def test_close_ends_at_an_intersection_are_left_to_eq_8() -> None:
    # An acute crossing: arms at +-14 degrees have ends 16 mm apart on either side, but belong across.
    strands = [arm(14), arm(-14), arm(166), arm(194)]
    at_centre = np.zeros((1, 3))
    assert len(reconnect_close_ends(strands, at_centre, PARAMETERS)) == 4


def far_end(degrees: float) -> tuple[int, int]:
    return round(103 * np.cos(np.radians(degrees))), round(103 * np.sin(np.radians(degrees)))


def pairs(*angles: tuple[float, float]) -> set[frozenset[tuple[int, int]]]:
    return {frozenset({far_end(a), far_end(b)}) for a, b in angles}


@pytest.mark.parametrize(
    "angles",
    [[(0, 180), (90, 270)], [(20, 200), (-20, 160)], [(0, 160), (80, 265)], [(0, 180), (60, 240), (120, 300)]],
    ids=["right angle", "acute", "bent", "six ends"],
)
def test_ends_at_an_intersection_are_paired_straight_through(angles: list[tuple[float, float]]) -> None:
    strands = [arm(angle) for angle in sorted(a for pair in angles for a in pair)]
    joined = connect_at_intersections(strands, np.zeros((1, 3)), PARAMETERS)
    assert spans(joined) == pairs(*angles)
    assert not any(s.closed for s in joined)


def test_the_minimum_total_counts_and_not_the_best_pair() -> None:
    # 0 with 180 is the straightest pair of all, but leaves 130 with 230: cos 180 + cos 100 = -1.17.
    # 0 with 130 and 180 with 230 is worse, 0 with 230 and 130 with 180 too.
    joined = connect_at_intersections([arm(a) for a in (0, 130, 180, 230)], np.zeros((1, 3)), PARAMETERS)
    assert spans(joined) == pairs((0, 180), (130, 230))
    # 40 with 220 is straight, but leaves 0 with 260, which do not continue one another: -1 + cos 100 = -1.17.
    # 0 with 220 and 40 with 260: 2 cos 140 = -1.53.
    joined = connect_at_intersections([arm(a) for a in (0, 40, 220, 260)], np.zeros((1, 3)), PARAMETERS)
    assert spans(joined) == pairs((0, 220), (40, 260))


def test_an_odd_end_is_left_over() -> None:
    joined = connect_at_intersections([arm(0), arm(100), arm(180)], np.zeros((1, 3)), PARAMETERS)
    assert spans(joined) == pairs((0, 180)) | spans([arm(100)])


def test_the_maximum_number_of_pairs_is_joined() -> None:
    # 0 with 180 alone would be the minimum total, -1, but would leave two ends that lead into the intersection.
    # Of the ways to join all four, 0 with 170 and 100 with 180 has the minimum: -0.98 + 0.17.
    joined = connect_at_intersections([arm(a) for a in (0, 100, 170, 180)], np.zeros((1, 3)), PARAMETERS)
    assert spans(joined) == pairs((0, 170), (100, 180))


def test_pairs_that_would_fold_back_are_not_joined() -> None:
    # Two ends that both leave to the right.
    assert len(connect_at_intersections([arm(0), arm(40)], np.zeros((1, 3)), PARAMETERS)) == 2


def test_ends_far_from_the_centre_or_pointing_away_do_not_gather() -> None:
    # r_cf + r_n = 45 mm.
    strands = [arm(0, inner_mm=46), arm(180, inner_mm=46)]
    assert len(connect_at_intersections(strands, np.zeros((1, 3)), PARAMETERS)) == 2
    # The end at 40 mm faces the other strand, but away from the centre.
    strands = [strand((20, 0), (40, 0)), strand((44, 0), (110, 0))]
    assert len(connect_at_intersections(strands, np.zeros((1, 3)), PARAMETERS)) == 2


def test_two_centres_of_one_intersection_are_one() -> None:
    # Strands that cross at an acute angle are merged: two centres 40 mm apart, four ends around them.
    strands = [strand((50, 12), (120, 30)), strand((50, -12), (120, -30))]
    strands += [strand((-50, -12), (-120, -30)), strand((-50, 12), (-120, 30))]
    centres = np.array([[-0.02, 0.0, 0.0], [0.02, 0.0, 0.0]])
    joined = connect_at_intersections(strands, centres, PARAMETERS)
    assert spans(joined) == {frozenset({(120, 30), (-120, -30)}), frozenset({(120, -30), (-120, 30)})}


def test_a_gap_under_another_strand_is_joined_and_the_same_gap_in_the_open_is_not() -> None:
    strands = [strand((-100, 0), (-30, 0)), strand((30, 0), (100, 0))]
    own = np.vstack([s.points for s in strands])
    over = straight((0, -60), (0, 60), z_mm=20)
    assert spans(connect_across_gaps(strands, np.vstack([own, over]), PARAMETERS)) == {frozenset({(-100, 0), (100, 0)})}
    assert spans(connect_across_gaps(strands, own, PARAMETERS)) == spans(strands)
    # Something that lies beside the gap hides nothing.
    beside = straight((0, 15), (0, 60), z_mm=20)
    assert len(connect_across_gaps(strands, np.vstack([own, beside]), PARAMETERS)) == 2


def test_too_wide_a_gap_is_not_joined_even_if_hidden() -> None:
    strands = [strand((-100, 0), (-36, 0)), strand((36, 0), (100, 0))]
    sheet = np.vstack([straight((-40, y), (40, y), z_mm=20) for y in (-5, 0, 5)])
    assert len(connect_across_gaps(strands, sheet, PARAMETERS)) == 2
    nearer = [strand((-100, 0), (-34, 0)), strand((34, 0), (100, 0))]
    assert len(connect_across_gaps(nearer, sheet, PARAMETERS)) == 1


def test_ends_that_do_not_face_each_other_across_a_gap_stay_apart() -> None:
    over = straight((0, -60), (0, 60), z_mm=20)
    # Displaced sideways: each would have to turn by 70 degrees.
    strands = [strand((-100, -25), (-10, -25)), strand((10, 25), (100, 25))]
    assert len(connect_across_gaps(strands, over, PARAMETERS)) == 2


def test_reconstruct_runs_all_steps() -> None:
    segments = [straight((-150, 0), (-70, 0)), straight((-55, 0), (-33, 0)), straight((33, 0), (120, 0))]
    segments += [straight((0, -33), (0, -120)), straight((0, 33), (0, 120))]
    result = reconstruct([*segments, np.empty((0, 3))], np.zeros((1, 3)), np.vstack(segments), PARAMETERS)
    assert len(result.reconnected) == 4
    assert spans(result.connected) == {frozenset({(-150, 0), (120, 0)}), frozenset({(0, -120), (0, 120)})}


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 359), st.booleans()), min_size=2, max_size=7, unique_by=lambda a: a[0]))
def test_no_measured_point_is_lost_and_direction_does_not_matter(arms: list[tuple[int, bool]]) -> None:
    as_measured = [arm(angle).points for angle, _ in arms]
    turned = [p[::-1] if turn else p for p, (_, turn) in zip(as_measured, arms, strict=True)]
    centre = np.zeros((1, 3))
    surface = np.vstack(as_measured)
    found = [reconstruct(segments, centre, surface, PARAMETERS).connected for segments in (as_measured, turned)]
    for strands in found:
        measured = np.vstack([s.points[~s.bridged] for s in strands])
        assert sorted(map(tuple, measured)) == sorted(map(tuple, surface))
    assert spans(found[0]) == spans(found[1])


def test_the_maximum_number_of_pairs_is_joined_however_well_fewer_would_fit() -> None:
    # Six ends in a row: those next to one another may be joined. Two pairs would continue straight, three bend.
    turns = np.radians([0, 60, 240, 300, 120, 180])
    ends = [
        End(k, True, np.array([0.1 * k, 0.0, 0.0]), np.array([np.cos(turn), np.sin(turn), 0.0]))
        for k, turn in enumerate(turns)
    ]
    allowed = np.abs(np.subtract.outer(np.arange(6), np.arange(6))) == 1
    strands = [strand((100 * k, 0), (100 * k, 100)) for k in range(6)]
    products = inner_products(ends)
    np.testing.assert_allclose(products[[0, 1, 2, 3, 4], [1, 2, 3, 4, 5]], [0.5, -1, 0.5, -1, 0.5], atol=1e-12)
    assert sorted(straightest_pairs(ends, allowed, strands, PARAMETERS)) == [(0, 1), (2, 3), (4, 5)]
