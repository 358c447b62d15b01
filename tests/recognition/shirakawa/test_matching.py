"""The matching method, step by step on hand-made points (r_n = 10 mm, r_f = 20 mm)."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from recognition.parameters import ChainParameters
from recognition.shirakawa.matching import SearchField, match_points, next_point, starting_order


def on_x(*millimetres: float) -> np.ndarray:
    return np.array([(x / 1000, 0.0, 0.0) for x in millimetres])


def test_steps_1_and_2_points_in_the_inner_sphere_cannot_be_connected(round_figures: ChainParameters) -> None:
    search = SearchField(on_x(0, 5, -9.9, 10.1, 15, 30))
    next_point(search, 0, round_figures)
    # The target itself, 5 and -9.9 mm; the linked point at 10.1 mm is not the centre yet.
    assert search.connectable.tolist() == [False, False, False, True, True, True]


def test_step_3_the_sequence_finishes_without_a_connectable_point_in_the_outer_sphere(
    round_figures: ChainParameters,
) -> None:
    search = SearchField(on_x(0, 5, 20.1))
    assert next_point(search, 0, round_figures) is None
    # A point within r_f that has been passed already is none.
    search = SearchField(on_x(0, 15))
    search.connectable[1] = False
    assert next_point(search, 0, round_figures) is None


def test_step_4_the_nearest_connectable_point_is_linked(round_figures: ChainParameters) -> None:
    # 3 mm is nearer but eliminated, 18 mm is connectable but farther.
    assert next_point(SearchField(on_x(0, 3, 18, 12, -14)), 0, round_figures) == 3
    # Nearest in space, not along x.
    points = np.vstack([on_x(0, 14), [(0.0, 0.008, -0.008)]])
    assert next_point(SearchField(points), 0, round_figures) == 2


def test_step_5_the_linked_point_becomes_the_next_target(round_figures: ChainParameters) -> None:
    # From 0, 29 mm is out of reach; from 12 mm it is within r_f, and 21 mm is within its r_n.
    points = on_x(0, 12, 21, 29)
    search = SearchField(points)
    first = next_point(search, 0, round_figures)
    assert first == 1
    assert next_point(search, first, round_figures) == 3
    assert not search.connectable[2]


def test_step_6_links_go_on_to_the_end_and_then_the_next_sequence_starts(round_figures: ChainParameters) -> None:
    # Two rows 20 cm apart: the first starts at its end with fewer neighbours, and so does the second.
    points = on_x(0, 12, 24, 36, 200, 212, 224)
    assert match_points(points, round_figures) == [[0, 1, 2, 3], [4, 5, 6]]


def test_sequences_start_where_there_are_fewest_neighbours() -> None:
    search = SearchField(on_x(10, 0, 20, 30, 40))
    # The ends 0 and 40 mm have two points within 15 mm, the others three.
    assert starting_order(search, 0.015).tolist() == [1, 4, 0, 2, 3]


def test_a_straight_line_in_any_order_is_one_segment_from_end_to_end(round_figures: ChainParameters) -> None:
    x = np.random.default_rng(0).permutation(np.arange(0.0, 300.0, 2.0))
    points = on_x(*x)
    (segment,) = match_points(points, round_figures)
    found = points[segment, 0]
    steps = np.diff(found)
    # One direction throughout, each link just beyond r_n (points are 2 mm apart), up to within r_n of the end.
    assert (np.sign(steps) == np.sign(steps[0])).all()
    assert (np.abs(steps) > round_figures.r_n).all()
    assert (np.abs(steps) <= round_figures.r_n + 0.0021).all()
    assert {0.0, 0.298} & {found[0], found[-1]}
    assert found.max() - found.min() >= 0.298 - round_figures.r_n


@settings(deadline=None, max_examples=60)
@given(hnp.arrays(np.float64, st.tuples(st.integers(0, 60), st.just(3)), elements=st.floats(0, 0.08)))
def test_in_any_cloud_links_are_between_the_spheres_and_no_point_stays_connectable(points: np.ndarray) -> None:
    parameters = ChainParameters.for_radius(0.01)
    segments = match_points(points, parameters)
    linked = [i for segment in segments for i in segment]
    assert len(linked) == len(set(linked))
    for segment in segments:
        lengths = np.linalg.norm(np.diff(points[segment], axis=0), axis=1)
        # The KD-tree compares squares: a rounding more or less.
        assert (lengths > parameters.r_n * (1 - 1e-12)).all()
        assert (lengths <= parameters.r_f * (1 + 1e-12)).all()
    if len(points):
        # "These sequences repeat until all points are unconnectable": each is in some target's inner sphere.
        distance = np.linalg.norm(points[:, None] - points[linked][None], axis=2).min(axis=1)
        assert (distance <= parameters.r_n * (1 + 1e-12)).all()


def test_no_points_no_segments(round_figures: ChainParameters) -> None:
    assert match_points(np.empty((0, 3)), round_figures) == []
    assert match_points(np.zeros((1, 3)), round_figures) == [[0]]


def test_at_a_wide_crossing_strands_are_misrecognised(round_figures: ChainParameters) -> None:
    """The weakness that section III.A describes and Fig. 8 shows: this is why the enhanced method is there."""
    straight, turned = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        along = rng.uniform(-0.15, 0.15, 900)
        # Two crossing centre line clouds, merged at the crossing to a width of 2 r.
        across = rng.uniform(-1, 1, 900) * np.where(np.abs(along) < 0.02, 0.01, 0.002)
        points = np.vstack([np.column_stack([along, across]), np.column_stack([across, along])])
        points = np.column_stack([points, np.zeros(1800)])
        spans = [np.ptp(points[segment, :2], axis=0) for segment in match_points(points, round_figures)]
        straight.append(sum(span.max() > 0.26 and span.min() < 0.05 for span in spans))
        turned.append(any(span.min() > 0.13 for span in spans))
    # Both strands from end to end would be 2. Some sequences even continue along the other strand.
    assert max(straight) < 2
    assert any(turned)
