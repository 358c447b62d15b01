"""Intersections of polylines in the projection onto the table."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from recognition.geometry.intersections import find_intersections
from recognition.geometry.polyline import arc_length, points_at
from recognition.strand import Strand

walks = st.lists(
    arrays(np.float64, st.tuples(st.integers(2, 9), st.just(3)), elements=st.floats(-1, 1, width=16)), max_size=3
)


def strand(points: np.ndarray, closed: bool = False) -> Strand:
    return Strand(points, np.zeros(len(points), dtype=bool), closed)


def crosses(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    """Return whether link ab crosses link cd: the ends of each lie on different sides of the other."""

    def side(p: np.ndarray, q: np.ndarray, of: np.ndarray) -> float:
        return float(np.sign((q - p)[0] * (of - p)[1] - (q - p)[1] * (of - p)[0]))

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


@given(walks)
def test_every_pair_of_links_that_intersects_is_found(points: list[np.ndarray]) -> None:
    links = [(k, m, walk[m], walk[m + 1]) for k, walk in enumerate(points) for m in range(len(walk) - 1)]
    expected = {
        (i, j)
        for (i, m, a, b), (j, n, c, d) in combinations(links, 2)
        if crosses(a, b, c, d) and not (i == j and abs(m - n) <= 1)
    }
    found = find_intersections([strand(walk) for walk in points])
    # Links that only touch may count or not.
    assert expected <= {intersection.strands for intersection in found}
    assert [intersection.strands for intersection in found] == sorted(intersection.strands for intersection in found)
    for intersection in found:
        for k in (0, 1):
            point = points_at(points[intersection.strands[k]], np.array([intersection.s_m[k]]))[0]
            np.testing.assert_allclose(point, [*intersection.xy, intersection.heights_m[k]], rtol=0, atol=1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_a_crossing_in_a_rings_first_point_is_found_once(turned: bool) -> None:
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(40)])
    line = np.array([(0.3, 0.0, 1.0), (1.7, 0.0, 1.0)])
    (found,) = find_intersections([strand(ring, closed=True), strand(line[::-1] if turned else line)])
    assert found.s_m[1] == pytest.approx(0.7, abs=1e-9)


def test_a_ring_that_crosses_itself_in_its_first_point_is_found_once() -> None:
    # A figure eight that begins in its middle.
    t = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    eight = np.column_stack([np.sin(t), np.sin(2 * t) / 2, np.cos(t)])
    (found,) = find_intersections([strand(eight, closed=True)])
    half = arc_length(np.vstack([eight, eight[:1]]))[40]
    assert abs(found.s_m[0] - found.s_m[1]) == pytest.approx(half, abs=1e-9)
    assert sorted(found.heights_m) == pytest.approx([-1, 1], abs=1e-9)


def test_links_of_zero_length_intersect_nothing() -> None:
    assert find_intersections([strand(np.zeros((3, 3))), strand(np.array([(-1.0, 0, 1), (1, 0, 1)]))]) == []
    assert find_intersections([]) == []
