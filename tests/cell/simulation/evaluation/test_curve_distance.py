import numpy as np
import pytest

from cell.simulation.evaluation.curve_distance import DENSE_SPACING_M, NearestPoints, Polyline


def circle(radius_m: float, count: int) -> np.ndarray:
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])


def test_a_closed_line_includes_its_closing_segment() -> None:
    points = circle(0.05, 400)
    line = Polyline.of(points, closed=True)
    # A polygon of 400 sides is shorter than its circle by a share of pi^2 / 6 / 400^2 = 1e-5.
    assert line.length_m == pytest.approx(2 * np.pi * 0.05, rel=2e-5)
    assert Polyline.of(line.points, closed=True).length_m == line.length_m, "the first point is not appended again"
    assert line.length_m > Polyline.of(points, closed=False).length_m
    even = line.evenly_spaced(10)
    assert np.linalg.norm(even - np.roll(even, 1, axis=0), axis=1) == pytest.approx(
        np.full(10, 2 * 0.05 * np.sin(np.pi / 10)), rel=1e-4
    )


def test_even_points_of_an_open_line_include_its_ends() -> None:
    line = Polyline(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.3, 0.0]]))
    assert line.evenly_spaced(5) == pytest.approx(
        np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.0], [0.1, 0.2, 0.0], [0.1, 0.3, 0.0]])
    )


def test_distances_are_exact_between_samples_and_beyond_ends() -> None:
    nearest = NearestPoints([Polyline(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]))])
    # Halfway between two samples, at a sample, and beyond each end.
    points = np.array(
        [
            [10.5 * DENSE_SPACING_M, 0.0001, 0.0],
            [10 * DENSE_SPACING_M, 0.0, 0.002],
            [-0.003, 0.004, 0.0],
            [0.103, 0.0, 0.004],
        ]
    )
    assert nearest.distance(points) == pytest.approx([0.0001, 0.002, 0.005, 0.005], rel=1e-9)


def test_lines_are_not_connected_to_each_other() -> None:
    nearest = NearestPoints(
        [
            Polyline(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])),
            Polyline(np.array([[0.1, 0.01, 0.0], [0.2, 0.01, 0.0]])),
        ]
    )
    assert nearest.points(np.array([[0.101, 0.004, 0.0]])) == pytest.approx(np.array([[0.1, 0.0, 0.0]]))


def test_a_line_without_length_is_a_point() -> None:
    line = Polyline(np.full((3, 3), 0.02))
    assert NearestPoints([line]).distance(np.array([[0.02, 0.02, 0.03]])) == pytest.approx([0.01])
