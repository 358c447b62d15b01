"""Centre line estimation, eqs. (1) and (2)."""

from collections.abc import Callable

import numpy as np

from recognition.centre_line import estimate_centre_line
from recognition.outlier_filter import NEIGHBOURS
from recognition.parameters import ChainParameters

AXIS = np.column_stack([np.arange(-0.05, 0.05, 0.001), np.zeros(100), np.full(100, 0.02)])


def test_on_a_cylinder_of_exact_normals_each_centre_is_r_below_and_on_the_axis(
    table_1: ChainParameters, tube: Callable
) -> None:
    points, normals = tube(AXIS, table_1.r)
    line = estimate_centre_line(points, normals, table_1)
    # Eq. (1), to the roundings of doubles below 0.1 m.
    np.testing.assert_allclose(np.linalg.norm(points - line.single, axis=1), table_1.r, rtol=0, atol=1e-15)
    np.testing.assert_allclose(line.single, np.repeat(AXIS, 24, axis=0), rtol=0, atol=1e-12)
    # Eq. (2): the mean of points on the axis is on the axis.
    np.testing.assert_allclose(line.points[:, 1:], np.broadcast_to((0.0, 0.02), (len(line.points), 2)), atol=1e-12)
    # All alike but for the ends: nothing is an outlier.
    assert len(line.points) == len(points)


def test_the_means_are_drawn_inwards_at_the_ends_and_nowhere_else(table_1: ChainParameters, tube: Callable) -> None:
    points, normals = tube(AXIS, table_1.r)
    x = estimate_centre_line(points, normals, table_1).points[:, 0]
    drawn = np.abs(x - points[:, 0])
    # A full, symmetric neighbourhood of 2 r has its middle at its centre.
    assert drawn[np.abs(points[:, 0]) < 0.05 - 2 * table_1.r - 0.001].max() < 1e-12
    # A half one has it within the reach of 2 r.
    assert 0.5 * table_1.r < np.abs(AXIS[0, 0] - x.min()) < 2 * table_1.r


def test_wrong_normals_average_out_around_the_string(table_1: ChainParameters, tube: Callable) -> None:
    points, normals = tube(AXIS, table_1.r)
    tilted = normals + 0.2 * np.random.default_rng(1).standard_normal(normals.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    line = estimate_centre_line(points, tilted, table_1)
    off_single = np.linalg.norm(line.single[:, 1:] - (0.0, 0.02), axis=1)
    off_means = np.linalg.norm(line.points[:, 1:] - (0.0, 0.02), axis=1)
    # 11 degrees of error: single centres are off by 0.2 r across; the means over some 250 of them hardly.
    assert off_single.mean() > 0.15 * table_1.r
    assert off_means.max() < 0.1 * table_1.r


def test_eq_2_by_a_loop(table_1: ChainParameters) -> None:
    # So few points that the outlier filter keeps them all.
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


def test_a_centre_that_stands_alone_is_removed(table_1: ChainParameters, tube: Callable) -> None:
    points, normals = tube(AXIS, table_1.r)
    alone = np.array([[0.0, 0.08, 0.02]])
    line = estimate_centre_line(np.vstack([points, alone]), np.vstack([normals, [(0, 0, 1)]]), table_1)
    assert len(line.single) == len(points) + 1
    assert line.points[:, 1].max() < 1e-9
