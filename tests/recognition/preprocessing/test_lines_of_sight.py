"""Lines of sight that pass a point, or stop at a string there."""

import numpy as np

from cell.simulation.scenes.clutter import Box
from recognition.preprocessing.lines_of_sight import ViewCounts, count_views
from tests.recognition.captured_strings import R, along_x, captured


def test_no_view_looks_through_a_string_and_all_look_through_free_space() -> None:
    views = captured(along_x(-0.1, 0.1))
    counts = count_views(along_x(-0.095, 0.095), R, views)
    assert counts.through.max() == 0
    assert counts.stopped.min() >= 4
    beside = along_x(-0.1, 0.1) + [0.0, 6 * R, 0.0]
    assert count_views(beside, R, views).through.min() >= 4
    for none in (count_views(along_x(5.0, 6.0), R, views), count_views(beside, R, [])):
        assert none.through.max() == none.stopped.max() == 0, "outside of all images, and without views"


def test_a_point_that_an_object_hides_is_not_looked_through() -> None:
    box = Box((0.0, 0.0), (0.12, 0.12, 0.03), 0.0)
    counts = count_views(along_x(-0.03, 0.03), R, captured(along_x(-0.1, 0.1), boxes=(box,)))
    assert counts.through.max() == counts.stopped.max() == 0


def test_half_of_the_views_must_look_through_a_free_point() -> None:
    through, stopped = np.array([2, 3, 3, 3, 0]), np.array([0, 0, 3, 4, 0])
    assert ViewCounts(through, stopped, views=8).is_free.tolist() == [False, True, True, False, False]
