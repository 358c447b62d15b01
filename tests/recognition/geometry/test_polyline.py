"""Polylines: lengths, places at lengths, even steps."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from recognition.geometry.polyline import arc_length, close_polyline, points_at, resample

CORNERS = np.array([(0.0, 0.0, 0.0), (0.03, 0.0, 0.0), (0.03, 0.04, 0.0)])

polylines = arrays(np.float64, st.tuples(st.integers(2, 12), st.sampled_from((2, 3))), elements=st.floats(-1, 1))


def test_arc_length_adds_up_the_links() -> None:
    np.testing.assert_allclose(arc_length(CORNERS), (0, 0.03, 0.07), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(arc_length(CORNERS[:1]), [0.0])
    np.testing.assert_allclose(arc_length(close_polyline(CORNERS, True)), (0, 0.03, 0.07, 0.12), rtol=0, atol=1e-15)
    assert close_polyline(CORNERS, False) is CORNERS


def test_places_lie_on_the_links_and_beyond_the_ends_at_the_ends() -> None:
    places = points_at(CORNERS, np.array([-1.0, 0.0, 0.01, 0.05, 0.07, 9.0]))
    truth = [(0, 0, 0), (0, 0, 0), (0.01, 0, 0), (0.03, 0.02, 0), (0.03, 0.04, 0), (0.03, 0.04, 0)]
    np.testing.assert_allclose(places, truth, rtol=0, atol=1e-15)


@given(polylines, st.floats(0.01, 0.5))
def test_even_steps_keep_both_ends_and_are_no_longer_than_told(points: np.ndarray, step: float) -> None:
    found = resample(points, step)
    np.testing.assert_allclose(found[[0, -1]], points[[0, -1]], rtol=0, atol=1e-12)
    # The way along the polyline between two places is one step; straight across a corner it is less.
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() <= step * (1 + 1e-6)
    assert len(found) == max(np.ceil(arc_length(points)[-1] / step - 1e-9), 2) + 1


@given(polylines, st.floats(0, 1))
def test_the_place_at_a_corners_length_is_the_corner(points: np.ndarray, share: float) -> None:
    corner = round(share * (len(points) - 1))
    np.testing.assert_allclose(points_at(points, arc_length(points)[[corner]])[0], points[corner], rtol=0, atol=1e-9)


def test_a_polyline_of_no_length_is_its_point() -> None:
    np.testing.assert_array_equal(resample(np.ones((2, 3)), 0.1), np.ones((3, 3)))
