"""Nodes linked to fragments, on hand-made nodes in millimetres with r = 10 mm."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recognition.parameters import ChainParameters
from recognition.tracing.fragments import Fragment, link_nodes, split_over_bare_table
from recognition.tracing.nodes import CentreLineNodes
from recognition.tracing.occlusion_map import OcclusionMap

PARAMETERS = ChainParameters.for_radius(0.01)
R = 0.0042


def nodes(points_mm: np.ndarray, directions: np.ndarray, support: float = 1.0, rho: float = 0.95) -> CentreLineNodes:
    count = len(points_mm)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return CentreLineNodes(points_mm / 1000, unit, np.full(count, support), np.full(count, rho))


def along(
    start_mm: tuple[float, ...],
    end_mm: tuple[float, ...],
    step_mm: float = 10.0,
    support: float = 1.0,
    rho: float = 0.95,
) -> CentreLineNodes:
    a, b = np.array(start_mm, dtype=np.float64), np.array(end_mm, dtype=np.float64)
    count = round(np.linalg.norm(b - a) / step_mm) + 1
    return nodes(np.linspace(a, b, count), np.tile(b - a, (count, 1)), support, rho)


def ring(radius_mm: float, count: int) -> CentreLineNodes:
    angle = np.arange(count) / count * 2 * np.pi
    c, s, o = np.cos(angle), np.sin(angle), np.zeros(count)
    return nodes(np.column_stack([radius_mm * c, radius_mm * s, o]), np.column_stack([-s, c, o]))


def together(*parts: CentreLineNodes) -> CentreLineNodes:
    return CentreLineNodes(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("points", "directions", "support", "rho")
        )
    )


def spans(fragments: list[Fragment]) -> set[frozenset[tuple[int, ...]]]:
    """Return for each fragment the whole millimetres of its two ends, in any order."""
    return {frozenset(tuple(np.rint(1000 * f.points[k]).astype(int)) for k in (0, -1)) for f in fragments}


def test_a_row_of_nodes_is_one_fragment_in_order() -> None:
    row = along((0, 0, 0), (100, 0, 0))
    (fragment,) = link_nodes(row[np.random.default_rng(0).permutation(11)], PARAMETERS)
    assert not fragment.closed
    x = fragment.points[:, 0] if fragment.points[0, 0] == 0 else fragment.points[::-1, 0]
    np.testing.assert_allclose(x, np.arange(11) / 100, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(fragment.support, 1)


@pytest.mark.parametrize("degrees", [30, 60, 90])
def test_strands_that_cross_are_two_fragments(degrees: float) -> None:
    # The centre lines 1.2 r apart, as for soft strands that are pressed together.
    c, s = 100 * np.cos(np.radians(degrees)), 100 * np.sin(np.radians(degrees))
    fragments = link_nodes(together(along((-100, 0, 0), (100, 0, 0)), along((-c, -s, 12), (c, s, 12))), PARAMETERS)
    x, y = round(c), round(s)
    assert spans(fragments) == {frozenset({(-100, 0, 0), (100, 0, 0)}), frozenset({(-x, -y, 12), (x, y, 12)})}


def test_a_gap_longer_than_a_link_ends_a_fragment() -> None:
    # The longest link is 22 mm.
    joined = link_nodes(together(along((0, 0, 0), (50, 0, 0)), along((71, 0, 0), (121, 0, 0))), PARAMETERS)
    assert spans(joined) == {frozenset({(0, 0, 0), (121, 0, 0)})}
    apart = link_nodes(together(along((0, 0, 0), (50, 0, 0)), along((73, 0, 0), (123, 0, 0))), PARAMETERS)
    assert spans(apart) == {frozenset({(0, 0, 0), (50, 0, 0)}), frozenset({(73, 0, 0), (123, 0, 0)})}


@pytest.mark.parametrize("hole_mm", [11, 14])
def test_representatives_link_across_the_nodes_they_represent(hole_mm: float) -> None:
    # The representatives are 12 mm farther apart than the nodes they represent: more than the 22 mm of a link.
    row = together(
        along((0, 0, 0), (50, 0, 0), support=2.0),
        along((56, 0, 0), (56 + hole_mm, 0, 0), step_mm=hole_mm),
        along((62 + hole_mm, 0, 0), (72 + hole_mm, 0, 0), support=2.0),
    )
    (fragment,) = link_nodes(row, PARAMETERS)
    assert spans([fragment]) == {frozenset({(0, 0, 0), (72 + hole_mm, 0, 0)})}
    # None of the others has come back.
    np.testing.assert_array_equal(fragment.support, 2.0)


def test_a_hole_between_represented_nodes_ends_a_fragment() -> None:
    # 16 mm, more than the 15 mm that leave no hole, and 28 mm between the nodes left.
    left, right = along((0, 0, 0), (50, 0, 0), support=2.0), along((78, 0, 0), (128, 0, 0), support=2.0)
    row = together(left, along((56, 0, 0), (72, 0, 0), step_mm=16), right)
    assert spans(link_nodes(row, PARAMETERS)) == spans(link_nodes(together(left, right), PARAMETERS))
    assert len(link_nodes(row, PARAMETERS)) == 2


def test_represented_nodes_side_by_side_or_round_a_corner_do_not_link() -> None:
    def end(start_mm: tuple[float, ...], end_mm: tuple[float, ...], beyond_mm: tuple[float, ...]) -> CentreLineNodes:
        """Return a row, and a node beyond its end that the last node represents."""
        offset = np.array([end_mm]) - np.array([start_mm])
        return together(along(start_mm, end_mm, support=2.0), nodes(np.array([beyond_mm], dtype=np.float64), offset))

    row = end((0, 0, 0), (50, 0, 0), (56, 0, 0))
    beside = end((110, 20, 0), (60, 20, 0), (54, 20, 0))
    corner = end((62, 62, 0), (62, 12, 0), (62, 6, 0))
    for other in (beside, corner):
        assert len(link_nodes(together(row, other), PARAMETERS)) == 2


def test_a_string_in_a_bend_is_followed_to_its_end_for_any_representatives() -> None:
    # The nodes at the end of a simulated scan's string: x, y, z, mm; the direction's x, y; the support. Those left,
    # (420.2, -32.3) and (426.6, -24.6), are 10 mm apart, more than the 9.24 mm of a link at r = 4.2 mm; what followed
    # was too short to be kept, and so the string ended 11 mm too early.
    table = np.array(
        [
            (404.7, -34.1, 3.8, -0.96, 0.27, 1.01),
            (406.1, -34.5, 3.8, -0.98, 0.22, 0.97),
            (408.6, -34.8, 3.8, -0.99, 0.10, 0.93),
            (410.8, -35.0, 3.8, -1.00, -0.01, 0.88),
            (412.7, -34.8, 3.9, -0.99, -0.15, 0.92),
            (415.6, -34.3, 3.9, -0.95, -0.32, 0.97),
            (417.5, -33.6, 3.9, -0.90, -0.43, 1.04),
            (418.5, -33.2, 3.9, -0.88, -0.47, 1.03),
            (420.2, -32.3, 3.9, -0.83, -0.56, 1.02),
            (422.0, -30.7, 3.9, -0.75, -0.66, 1.01),
            (425.3, -26.9, 3.8, -0.56, -0.83, 1.10),
            (425.8, -26.1, 3.8, -0.53, -0.85, 1.12),
            (426.6, -24.6, 3.8, -0.50, -0.87, 1.13),
            (427.3, -23.1, 3.8, -0.47, -0.88, 1.05),
            (428.1, -21.5, 3.8, -0.45, -0.89, 0.86),
            (429.1, -19.4, 3.9, -0.43, -0.90, 0.58),
        ]
    )
    measured = nodes(table[:, :3], np.column_stack([table[:, 3:5], np.zeros(len(table))]))
    measured.support[:] = table[:, 5]
    (fragment,) = link_nodes(measured, ChainParameters.for_radius(R))
    assert spans([fragment]) == {frozenset({(405, -34, 4), (428, -22, 4)})}


def test_strands_side_by_side_or_on_one_another_do_not_link() -> None:
    for offset in ((0, 20, 0), (0, 0, 20)):
        upper = along(offset, (100 + offset[0], offset[1], offset[2]))
        assert len(link_nodes(together(along((0, 0, 0), (100, 0, 0)), upper), PARAMETERS)) == 2


def test_a_corner_is_not_linked_round() -> None:
    fragments = link_nodes(together(along((0, 0, 0), (50, 0, 0)), along((50, 10, 0), (50, 60, 0))), PARAMETERS)
    assert spans(fragments) == {frozenset({(0, 0, 0), (50, 0, 0)}), frozenset({(50, 10, 0), (50, 60, 0)})}


def test_a_ring_closes_and_goes_round_once() -> None:
    (fragment,) = link_nodes(ring(60, 36), PARAMETERS)
    assert fragment.closed
    assert len(fragment.points) == 36
    angle = np.unwrap(np.arctan2(fragment.points[:, 1], fragment.points[:, 0]))
    np.testing.assert_allclose(np.abs(np.diff(angle)), np.radians(10), rtol=0, atol=1e-9)


def test_a_ring_no_wider_than_its_string_is_none() -> None:
    # Eleven nodes 10 mm apart: a ring of 18 mm radius, of a string of 10 mm.
    assert link_nodes(ring(10 / (2 * np.sin(np.pi / 11)), 11), PARAMETERS) == []


def test_few_nodes_or_nodes_of_no_line_are_dropped() -> None:
    assert link_nodes(along((0, 0, 0), (10, 0, 0)), PARAMETERS) == []
    assert len(link_nodes(along((0, 0, 0), (20, 0, 0)), PARAMETERS)) == 1
    # A plane's contribution rate is 1/2.
    assert link_nodes(along((0, 0, 0), (100, 0, 0), rho=0.55), PARAMETERS) == []


@pytest.mark.parametrize(
    ("length_mm", "rho", "of_strings", "is_kept"),
    [
        (300, 0.64, 0.72, True),  # as linear as the strings of the scene, which matching windows flattened
        (300, 0.58, 0.72, False),
        (300, 0.64, 0.95, False),  # the strings of this scene are lines, and this is none
        (100, 0.64, 0.72, False),  # so short a line may lie on a flat surface
    ],
)
def test_a_long_fragment_may_be_less_linear_where_all_strings_are(
    length_mm: float, rho: float, of_strings: float, is_kept: bool
) -> None:
    string = along((0, 0, 0), (400, 0, 0), rho=of_strings)
    other = along((0, 100, 0), (length_mm, 100, 0), rho=rho)
    assert len(link_nodes(together(string, other), PARAMETERS)) == 1 + is_kept
    assert link_nodes(other, PARAMETERS) == []


def test_poorly_supported_nodes_are_removed_at_the_ends_and_kept_inside() -> None:
    row = along((0, 0, 0), (100, 0, 0))
    row.support[[0, 1, 5, 10]] = 0.3
    (fragment,) = link_nodes(row, PARAMETERS)
    assert sorted(np.rint(1000 * fragment.points[:, 0]).astype(int)) == list(range(20, 100, 10))


def test_the_best_supported_of_close_nodes_represents_them() -> None:
    # Beside each node there is another, 3 mm off, with less support.
    doubled = together(along((0, 0, 0), (100, 0, 0), support=2.0), along((3, 3, 0), (103, 3, 0)))
    (fragment,) = link_nodes(doubled, PARAMETERS)
    np.testing.assert_array_equal(fragment.support, 2.0)
    assert len(fragment.points) == 11


def test_no_nodes_no_fragments() -> None:
    assert link_nodes(nodes(np.empty((0, 3)), np.empty((0, 3))), PARAMETERS) == []
    assert link_nodes(nodes(np.zeros((1, 3)), np.ones((1, 3))), PARAMETERS) == []


@settings(deadline=None, max_examples=30, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_neither_the_order_of_nodes_nor_the_sense_of_directions_matters(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = together(
        along((-100, 0, 0), (100, 0, 0)), along((-50, -87, 0), (50, 87, 0)), along((0, 120, 9), (90, 130, 0))
    )
    order = rng.permutation(len(scene.points))
    sense = rng.choice((-1.0, 1.0), (len(order), 1))
    same = CentreLineNodes(scene.points[order], sense * scene.directions[order], scene.support[order], scene.rho[order])
    assert spans(link_nodes(same, PARAMETERS)) == spans(link_nodes(scene, PARAMETERS))


def test_a_ring_is_cut_once_wherever_its_first_node_is() -> None:
    ring = Fragment(np.eye(20, 3), np.arange(20.0), closed=True)
    everything, nothing = np.ones(20, dtype=bool), np.zeros(20, dtype=bool)
    assert ring.split(everything, nothing) == [ring]
    for k in range(20):
        # One link is cut: the same nodes in order, from after the link round to before it.
        (piece,) = ring.split(everything, np.arange(20) == k)
        np.testing.assert_array_equal(piece.support, (np.arange(20) + k + 1) % 20)
        assert not piece.closed
        # A node is removed; then also a link is cut, 8 nodes on.
        (piece,) = ring.split(np.arange(20) != k, nothing)
        np.testing.assert_array_equal(piece.support, (np.arange(19) + k + 1) % 20)
        pieces = ring.split(np.arange(20) != k, np.arange(20) == (k + 8) % 20)
        assert sorted(len(piece.points) for piece in pieces) == [8, 11]


def test_an_open_fragment_is_split_into_parts() -> None:
    line = Fragment(np.eye(12, 3), np.arange(12.0))
    everything, last = np.ones(12, dtype=bool), np.arange(12) == 11
    # Nothing follows the last node.
    assert line.split(everything, last) == [line]
    pieces = line.split(np.arange(12) != 7, np.arange(12) == 3)
    # 0 to 3, 4 to 6 and 8 to 11; parts with fewer than three nodes are dropped.
    assert sorted(piece.support.tolist() for piece in pieces) == [[0, 1, 2, 3], [4, 5, 6], [8, 9, 10, 11]]
    assert [len(piece.points) for piece in line.split(everything, np.arange(12) == 1)] == [10]


def test_a_link_over_bare_table_is_cut_in_rings_too(seen: Callable, arc: Callable) -> None:
    angle = np.radians(np.arange(0, 360, 10))
    ring = np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), np.full(36, R)])
    # 28 mm between two nodes, 7 mm elsewhere; nothing is seen in the long one.
    ring = np.delete(ring, [10, 11, 12], axis=0)
    surface, _ = seen([arc(0.04, 125, 90 + 360)], R)
    for first in (0, 10, 11, 30):
        fragment = Fragment(np.roll(ring, -first, axis=0), np.ones(len(ring)), closed=True)
        (piece,) = split_over_bare_table([fragment], OcclusionMap(surface), R)
        assert not piece.closed
        assert len(piece.points) == len(ring)
