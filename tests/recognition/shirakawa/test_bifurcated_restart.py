"""Bifurcated restart (III.D) on hand-made points: r_n = 10, r_f = 20, r_cn = 30, r_cf = 35 mm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from recognition.parameters import ChainParameters
from recognition.shirakawa.bifurcated_restart import (
    approach_intersection,
    find_restarts,
    find_sharp_turn,
    intersection_ratios,
)
from recognition.shirakawa.matching import SearchField

CENTRE = np.zeros(3)


def mm(*points: tuple[float, float]) -> np.ndarray:
    return np.array([(x, y, 0.0) for x, y in points]) / 1000


def row(count: int) -> SearchField:
    """Points 15 mm apart along x: a sequence links each to the next."""
    return SearchField(mm(*((15.0 * i, 0.0) for i in range(count))))


# Whole coordinates and squares of radii between whole numbers: no distance is a rounding away from the radius.
@settings(deadline=None)
@given(
    hnp.arrays(np.float64, st.tuples(st.integers(1, 15), st.just(3)), elements=st.integers(-3, 3).map(float)),
    st.integers(0, 2**15 - 1),
    st.integers(0, 30).map(lambda n: float(np.sqrt(n + 0.5))),
)
def test_eq_7_by_a_loop(points: np.ndarray, bits: int, r_f: float) -> None:
    in_intersection = np.array([bool(bits >> i & 1) for i in range(len(points))])
    R_c = intersection_ratios(points, in_intersection, r_f)
    for p, ratio in zip(points, R_c, strict=True):
        neighbours = np.linalg.norm(points - p, axis=1) <= r_f
        n_n, n_c = neighbours.sum(), (neighbours & in_intersection).sum()
        assert ratio == pytest.approx(n_c / n_n, rel=1e-15)


def test_the_point_before_the_first_over_the_threshold_ends_the_segment(round_figures: ChainParameters) -> None:
    R_c = np.array([0.0, 0.2, 0.6, 0.75, 0.9, 0.8, 0.3])
    found = approach_intersection(row(7), R_c, [0], round_figures)
    assert found.segment == [0, 1, 2]


def test_the_local_maximum_is_the_bifurcation_centre(round_figures: ChainParameters) -> None:
    search = row(8)
    # A second, higher maximum belongs to another intersection.
    R_c = np.array([0.0, 0.2, 0.6, 0.75, 0.9, 0.8, 0.95, 1.0])
    found = approach_intersection(search, R_c, [0], round_figures)
    assert found.bifurcation_centre is not None
    np.testing.assert_array_equal(found.bifurcation_centre, search.points[4])


@pytest.mark.parametrize(
    ("R_c", "middle"),
    [
        ([0.0, 0.8, 0.9, 0.9, 0.9, 0.5], 3),
        ([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5], 3),
        # A plateau on the way up is not the top.
        ([0.0, 0.8, 0.8, 0.8, 0.95, 0.5], 4),
    ],
)
def test_of_a_plateau_the_middle_is_the_centre(round_figures: ChainParameters, R_c: list[float], middle: int) -> None:
    search = row(len(R_c))
    found = approach_intersection(search, np.array(R_c), [0], round_figures)
    assert found.bifurcation_centre is not None
    np.testing.assert_array_equal(found.bifurcation_centre, search.points[middle])


def test_the_threshold_itself_is_not_exceeded(round_figures: ChainParameters) -> None:
    found = approach_intersection(row(4), np.full(4, round_figures.R_t), [0], round_figures)
    assert found.segment == [0, 1, 2, 3]
    assert found.bifurcation_centre is None


def test_a_sequence_that_ends_in_the_open_has_no_centre(round_figures: ChainParameters) -> None:
    search = row(4)
    found = approach_intersection(search, np.zeros(4), [0], round_figures)
    assert (found.segment, found.bifurcation_centre) == ([0, 1, 2, 3], None)
    assert not search.connectable.any()


def test_a_restart_with_its_first_link_is_continued(round_figures: ChainParameters) -> None:
    search = row(5)
    search.connectable[:2] = False
    assert approach_intersection(search, np.zeros(5), [0, 1], round_figures).segment == [0, 1, 2, 3, 4]


def test_a_sequence_that_starts_inside_has_no_segment(round_figures: ChainParameters) -> None:
    search = row(3)
    found = approach_intersection(search, np.array([0.8, 0.9, 0.1]), [0], round_figures)
    assert found.segment == []
    assert found.bifurcation_centre is not None
    np.testing.assert_array_equal(found.bifurcation_centre, search.points[1])


def test_where_points_run_out_inside_the_highest_so_far_is_the_centre(round_figures: ChainParameters) -> None:
    search = row(4)
    found = approach_intersection(search, np.array([0.0, 0.1, 0.8, 0.9]), [0], round_figures)
    assert found.segment == [0, 1]
    assert found.bifurcation_centre is not None
    np.testing.assert_array_equal(found.bifurcation_centre, search.points[3])


def bent(degrees: float, n_before: int = 4, n_after: int = 4) -> np.ndarray:
    """Points 15 mm apart that turn once by that angle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first = [(15.0 * i, 0.0) for i in range(-n_before, 1)]
    return mm(*first, *((15.0 * i * c, 15.0 * i * s) for i in range(1, n_after + 1)))


def test_a_turn_that_no_string_makes_is_an_intersection(round_figures: ChainParameters) -> None:
    points = bent(85)
    # Checked after every link, the turn is found when two links follow it.
    assert [find_sharp_turn(points[:n]) for n in range(len(points) + 1)] == [None] * 7 + [4, None, None]
    found = approach_intersection(SearchField(points), np.zeros(9), [0], round_figures)
    assert found.segment == [0, 1, 2, 3]
    assert found.bifurcation_centre is not None
    np.testing.assert_array_equal(found.bifurcation_centre, points[4])


def test_a_bend_that_a_string_can_make_is_no_intersection(round_figures: ChainParameters) -> None:
    points = bent(65)
    assert [find_sharp_turn(points[:n]) for n in range(len(points) + 1)] == [None] * 10
    found = approach_intersection(SearchField(points), np.zeros(9), [0], round_figures)
    assert (found.segment, found.bifurcation_centre) == (list(range(9)), None)


def test_points_within_r_cn_are_eliminated_and_do_not_restart(round_figures: ChainParameters) -> None:
    search = SearchField(mm((0, 0), (20, 0), (0, 29.9), (0, 36)))
    assert find_restarts(search, CENTRE, round_figures) == []
    assert search.connectable.tolist() == [False, False, False, True]


def test_step_1_without_a_connectable_point_around_the_intersection_it_finishes(
    round_figures: ChainParameters,
) -> None:
    # Just beyond r_cf, and within it but passed already.
    search = SearchField(mm((35.1, 0), (0, 32)))
    search.connectable[1] = False
    assert find_restarts(search, CENTRE, round_figures) == []


def test_step_2_the_nearest_point_within_r_cf_is_the_restart(round_figures: ChainParameters) -> None:
    # 34 and 31 mm away, on arms of their own; the nearer is first.
    restarts = find_restarts(SearchField(mm((34, 0), (0, 31))), CENTRE, round_figures)
    assert restarts == [[1], [0]]


def test_steps_3_and_4_points_around_the_restart_are_eliminated(round_figures: ChainParameters) -> None:
    # 34 mm out on the same arm: within r_n of the restart at 31 mm, so neither restart nor link.
    search = SearchField(mm((31, 0), (34, 0), (40.9, 0)))
    assert find_restarts(search, CENTRE, round_figures) == [[0]]
    assert not search.connectable.any()


def test_step_5_the_restart_is_linked_to_the_nearest_within_r_f(round_figures: ChainParameters) -> None:
    search = SearchField(mm((31, 0), (48, 0), (45, 0), (51.1, 0)))
    assert find_restarts(search, CENTRE, round_figures) == [[0, 2]]
    # Outwards only: what lies towards the centre was eliminated before.
    search = SearchField(mm((31, 0), (20, 0), (-10, 0)))
    assert find_restarts(search, CENTRE, round_figures) == [[0]]


def test_step_6_it_returns_until_every_arm_has_its_restart(round_figures: ChainParameters) -> None:
    arms = [(31, 0), (43, 0), (-32, 0), (-44, 0), (0, 33), (0, 45), (0, -34), (0, -46)]
    assert find_restarts(SearchField(mm(*arms)), CENTRE, round_figures) == [[0, 1], [2, 3], [4, 5], [6, 7]]


def test_two_restarts_do_not_link_to_the_same_neighbourhood(round_figures: ChainParameters) -> None:
    # Two arms 16 mm apart: both would take the points around (44, 0), which only one can.
    search = SearchField(mm((31, 8), (31.2, -8), (44, 0), (45, -1)))
    restarts = find_restarts(search, CENTRE, round_figures)
    assert restarts == [[0, 2], [1]]
    assert not search.connectable.any()
