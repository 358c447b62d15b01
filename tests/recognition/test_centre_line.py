"""Centre line estimation, eqs. (1) and (2)."""

import numpy as np
import pytest

from recognition.centre_line import estimate_centre_line
from recognition.geometry.outlier_filter import NEIGHBOURS
from recognition.parameters import ChainParameters


@pytest.fixture(scope="module")
def cylinder(table_1: ChainParameters) -> tuple[np.ndarray, np.ndarray]:
    """2400 points and normals of a cylinder 10 cm long about x at z = 20 mm, wound around it at the golden angle."""
    angle = np.arange(2400) * np.pi * (3 - np.sqrt(5))
    normals = np.column_stack([np.zeros(2400), np.cos(angle), np.sin(angle)])
    axis = np.column_stack([np.linspace(-0.05, 0.05, 2400), np.zeros(2400), np.full(2400, 0.02)])
    return axis + table_1.r * normals, normals


def test_on_a_cylinder_of_exact_normals_each_centre_is_r_below_and_on_the_axis(
    table_1: ChainParameters, cylinder: tuple[np.ndarray, np.ndarray]
) -> None:
    points, normals = cylinder
    line = estimate_centre_line(points, normals, table_1)
    # Eq. (1), to the roundings of doubles below 0.1 m.
    np.testing.assert_allclose(np.linalg.norm(points - line.unaveraged, axis=1), table_1.r, rtol=0, atol=1e-15)
    axis = points * (1, 0, 0) + (0, 0, 0.02)
    np.testing.assert_allclose(line.unaveraged, axis, rtol=0, atol=1e-12)
    # Eq. (2): the mean of points on the axis is on the axis.
    np.testing.assert_allclose(line.points[:, 1:], np.broadcast_to((0.0, 0.02), (len(line.points), 2)), atol=1e-12)


def test_the_means_are_drawn_inwards_at_the_ends_and_nowhere_else(
    table_1: ChainParameters, cylinder: tuple[np.ndarray, np.ndarray]
) -> None:
    x = estimate_centre_line(*cylinder, table_1).points[:, 0]
    # Elsewhere they stay spread over the whole length: no gap is wider than a few steps of 0.04 mm.
    assert np.diff(np.sort(x[np.abs(x) < 0.05 - 3 * table_1.r])).max() < 0.0005
    # The mean of a one-sided neighbourhood of radius 2 r is less than 2 r from the end.
    for end in (0.05 + x.min(), 0.05 - x.max()):
        assert 0.5 * table_1.r < end < 2 * table_1.r


def test_wrong_normals_average_out_around_the_string(
    table_1: ChainParameters, cylinder: tuple[np.ndarray, np.ndarray]
) -> None:
    points, normals = cylinder
    tilted = normals + 0.2 * np.random.default_rng(1).standard_normal(normals.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    line = estimate_centre_line(points, tilted, table_1)
    off_unaveraged = np.linalg.norm(line.unaveraged[:, 1:] - (0.0, 0.02), axis=1)
    off_means = np.linalg.norm(line.points[:, 1:] - (0.0, 0.02), axis=1)
    # Errors of 11 degrees: each centre is off by 0.2 r across, and the means over some 250 centres by far less.
    assert off_unaveraged.mean() > 0.15 * table_1.r
    assert off_means.max() < 0.1 * table_1.r


def test_eq_2_by_a_loop(table_1: ChainParameters) -> None:
    # The outlier filter keeps all points of so small a cloud.
    rng = np.random.default_rng(2)
    points = rng.uniform(-0.01, 0.01, (NEIGHBOURS, 3))
    normals = rng.standard_normal((NEIGHBOURS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    line = estimate_centre_line(points, normals, table_1)
    c = [p - table_1.r * n for p, n in zip(points, normals, strict=True)]
    for i, p_i in enumerate(points):
        J_i = [j for j, p_j in enumerate(points) if np.linalg.norm(p_j - p_i) <= 2 * table_1.r]
        # Neighbours are those of the surface point p_i, not of c_i.
        np.testing.assert_allclose(line.points[i], np.mean([c[j] for j in J_i], axis=0), rtol=0, atol=1e-16)


def test_a_centre_that_stands_alone_is_removed(
    table_1: ChainParameters, cylinder: tuple[np.ndarray, np.ndarray]
) -> None:
    points, normals = cylinder
    alone = np.array([[0.0, 0.08, 0.02]])
    line = estimate_centre_line(np.vstack([points, alone]), np.vstack([normals, [(0, 0, 1)]]), table_1)
    assert len(line.unaveraged) == len(points) + 1
    assert line.points[:, 1].max() < 1e-9
