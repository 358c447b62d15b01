"""Shapes of objects that are round but no strings."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.refinement.object_shapes import is_fold, is_other_rod, is_upright, may_be_matched_bar
from recognition.refinement.refinement import FittedStrand

R = 0.004


def strand(points: np.ndarray, radius_m: float = R) -> FittedStrand:
    n = len(points)
    return FittedStrand(points, False, np.zeros(n, dtype=bool), np.full(n, 40.0), radius_m, radius_m, 0.0, 0.0, 0.05)


def arc(bend_per_m: float, height_m: float = R) -> np.ndarray:
    """Return a line of 0.12 m with a constant curvature."""
    x = np.linspace(-0.06, 0.06, 41)
    return np.column_stack([x, bend_per_m * x**2 / 2, np.full(len(x), height_m)])


def test_a_line_is_upright_from_60_degrees_on() -> None:
    up = np.linspace(0, 0.05, 20)[:, None]
    assert is_upright(up * (0.0, 0.0, 1.0))
    assert is_upright(up * (np.cos(1.1), 0.0, np.sin(1.1)) + (0.1, 0.2, 0.0))
    assert not is_upright(up * (np.cos(1.0), 0.0, np.sin(1.0)))
    assert not is_upright(arc(5.0))


def test_a_rod_is_straight_and_has_another_radius() -> None:
    # A radius of curvature of 20 m moves the middle of 120 mm by 0.09 mm, one of 1 m by 1.8 mm.
    assert is_other_rod(strand(arc(0.05), 1.5 * R), R)
    assert not is_other_rod(strand(arc(1.0), 1.5 * R), R)
    assert not is_other_rod(strand(arc(0.05), R), R)
    assert not is_other_rod(replace(strand(arc(0.05), 1.5 * R), closed=True), R)


@pytest.mark.parametrize(
    ("radius_m", "height_m", "expected"),
    [
        # Its top is 2.7 of its radii above the table, not 2.
        (0.7 * R, 1.2 * R, True),
        # A thinner string on the table, and on a sheet of a tenth of its diameter.
        (0.7 * R, 0.7 * R, False),
        (0.7 * R, 0.84 * R, False),
        # A string that lies on something.
        (R, 2 * R, False),
    ],
)
def test_a_fold_is_higher_than_its_width(radius_m: float, height_m: float, expected: bool) -> None:
    on_table = strand(arc(1.0, height_m + 0.1), radius_m)
    assert is_fold(on_table, R, table_z_m=0.1) == expected


def test_a_matched_bar_is_straight() -> None:
    # A radius of curvature of 2 m moves the middle of 120 mm by 0.9 mm, 0.3 mm root mean square; one of 0.2 m by 9 mm.
    assert may_be_matched_bar(strand(arc(0.5)))
    assert not may_be_matched_bar(strand(arc(5.0)))
    assert not may_be_matched_bar(replace(strand(arc(0.5)), closed=True))
