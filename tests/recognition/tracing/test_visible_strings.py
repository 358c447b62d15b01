"""Fragments that are visible parts of strings, and those that are edges of objects."""

from collections.abc import Callable

import numpy as np
import pytest

from recognition.tracing.fragments import Fragment
from recognition.tracing.visible_strings import VisibleStrings

R = 0.0042


def is_string(line: np.ndarray, surface: np.ndarray) -> bool:
    (found,) = VisibleStrings([Fragment(line, np.ones(len(line)))], surface, R).is_string
    return bool(found)


def test_a_string_stays_one_under_a_strand_without_a_fragment(straight: Callable, seen: Callable) -> None:
    # As in a tight knot: the strand across it is too short or too bent for a fragment, so its surface has no owner.
    line = straight((0, 0, R), (12 * R, 0, R))
    across = straight((3 * R, -5 * R, 3 * R), (3 * R, 5 * R, 3 * R))
    surface, _ = seen([line, across])
    assert is_string(line, surface)


@pytest.mark.parametrize("length_radii", [5.0, 12.0])
def test_the_edge_of_an_object_is_no_string(straight: Callable, seen: Callable, length_radii: float) -> None:
    edge = straight((0, 0, R), (length_radii * R, 0, R))
    surface, _ = seen([edge])
    x, y = np.meshgrid(np.arange(0.0, length_radii * R, 0.001), np.arange(0.0, 0.03, 0.001))
    top = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 2 * R)])
    assert is_string(edge, surface)
    assert not is_string(edge, np.vstack([surface, top]))


def test_a_fragment_without_surface_is_no_string(straight: Callable) -> None:
    assert not is_string(straight((0, 0, R), (8 * R, 0, R)), np.full((1, 3), 1.0))
