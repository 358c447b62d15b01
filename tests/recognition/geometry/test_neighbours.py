"""Sums and means over neighbourhoods, compared with brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from recognition.geometry.neighbours import neighbour_matrix, neighbourhood_means

# Integer coordinates, and radii whose squares lie between integers: no distance equals the radius.
grid_points = hnp.arrays(np.float64, st.tuples(st.integers(1, 12), st.just(3)), elements=st.integers(-4, 4).map(float))
radii = st.integers(0, 60).map(lambda n: float(np.sqrt(n + 0.5)))


@settings(deadline=None)
@given(grid_points, grid_points, radii)
def test_the_matrix_marks_every_pair_within_the_radius(centres: np.ndarray, points: np.ndarray, radius: float) -> None:
    distance = np.linalg.norm(centres[:, None] - points[None], axis=2)
    np.testing.assert_array_equal(
        neighbour_matrix(centres, points, radius).toarray(), (distance <= radius).astype(float)
    )


@settings(deadline=None)
@given(grid_points, grid_points, radii)
def test_means_equal_those_of_a_loop(centres: np.ndarray, points: np.ndarray, radius: float) -> None:
    values = points @ np.array([[1.0, -2.0], [0.5, 3.0], [2.0, 0.0]])
    means = neighbourhood_means(centres, points, values, radius)
    assert means.shape == (len(centres), 2)
    for centre, mean in zip(centres, means, strict=True):
        near = np.linalg.norm(points - centre, axis=1) <= radius
        if near.any():
            # The sums of integers are exact; only the division rounds.
            np.testing.assert_allclose(mean, values[near].mean(axis=0), rtol=1e-14, atol=1e-14)
        else:
            assert np.isnan(mean).all()


def test_a_point_is_its_own_neighbour_and_the_radius_is_included() -> None:
    points = np.array([[0.0, 0, 0], [2, 0, 0], [5, 0, 0]])
    np.testing.assert_array_equal(neighbour_matrix(points, points, 2.0).toarray(), [[1, 1, 0], [1, 1, 0], [0, 0, 1]])


def test_no_points() -> None:
    nothing = np.empty((0, 3))
    assert neighbour_matrix(nothing, nothing, 1.0).shape == (0, 0)
    assert neighbourhood_means(nothing, nothing, nothing, 1.0).shape == (0, 3)
    assert np.isnan(neighbourhood_means(np.zeros((2, 3)), nothing, nothing, 1.0)).all()
