"""Canonical order of the points of a chain."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from recognition.model.chains import canonical_order

OPEN = np.array([(0.2, 0.1, 0.0), (0.1, 0.3, 0.0), (0.0, 0.2, 0.0), (0.1, 0.0, 0.0), (0.3, 0.3, 0.0)])


@given(st.booleans())
def test_an_open_chain_begins_at_its_end_of_smaller_x(turned: bool) -> None:
    points = OPEN[::-1] if turned else OPEN
    np.testing.assert_array_equal(points[canonical_order(points, closed=False)], OPEN)


@given(st.integers(0, 4), st.booleans())
def test_a_closed_chain_begins_at_its_smallest_x_for_any_seam(seam: int, turned: bool) -> None:
    points = np.roll(OPEN[::-1] if turned else OPEN, seam, axis=0)
    # From (0, 0.2) both neighbours are at x = 0.1; that of smaller y comes next.
    np.testing.assert_array_equal(points[canonical_order(points, closed=True)], np.roll(OPEN, -2, axis=0))


def test_equal_x_is_decided_by_y() -> None:
    points = np.array([(0.0, 0.2, 0.0), (0.1, 0.1, 0.0), (0.0, 0.1, 0.0)])
    np.testing.assert_array_equal(canonical_order(points, closed=False), [2, 1, 0])
