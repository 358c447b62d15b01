import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cell.kinematics.capsule_distance import box_distances, segment_distances

point = st.lists(st.floats(-1, 1).map(lambda x: round(x, 3)), min_size=3, max_size=3).map(np.array)
SHARES = np.linspace(0, 1, 201)[:, None]
# Each point is at most half a step from a sample, and a segment is at most sqrt(12) long.
STEP = np.sqrt(12) / 400


@given(point, point, point, point)
def test_the_distance_of_segments_is_that_of_their_nearest_points(
    a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], d: NDArray[np.float64]
) -> None:
    found = float(segment_distances(a, b, c, d))
    tried = np.linalg.norm((a + SHARES * (b - a))[:, None] - (c + SHARES * (d - c))[None], axis=-1).min()
    assert found - 1e-6 <= tried <= found + 2 * STEP
    for other in (segment_distances(b, a, c, d), segment_distances(c, d, a, b)):
        assert float(other) == pytest.approx(found, abs=1e-6)


@pytest.mark.parametrize(
    ("pieces", "distance"),
    [
        (((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)), 1.0),  # side by side
        (((0, 0, 0), (1, 0, 0), (3, 0, 0), (4, 0, 0)), 2.0),  # one after the other on a line
        (((0, 0, 0), (2, 0, 0), (1, -1, 0.5), (1, 1, 0.5)), 0.5),  # crossing
        (((0, 0, 0), (0, 0, 0), (1, 1, 1), (1, 1, 1)), np.sqrt(3)),  # two points
        (((0, 0, 0), (1, 0, 0), (0.5, 2, 0), (0.5, 2, 0)), 2.0),  # a segment and a point
    ],
)
def test_segments_have_their_known_distance(pieces: tuple[tuple[float, ...], ...], distance: float) -> None:
    assert float(segment_distances(*(np.array(p, dtype=float) for p in pieces))) == pytest.approx(distance)


LOW, HIGH = np.array([-0.3, -0.2, -0.5]), np.array([0.4, 0.6, 0.1])


def depth(p: NDArray[np.float64]) -> NDArray[np.float64]:
    beyond = np.maximum(LOW - p, p - HIGH)
    return np.linalg.norm(beyond.clip(min=0), axis=-1) + beyond.max(axis=-1).clip(max=0)


@given(point, point)
def test_the_distance_of_a_segment_from_a_box_is_that_of_its_nearest_point(
    a: NDArray[np.float64], b: NDArray[np.float64]
) -> None:
    found = float(box_distances(a[None], b[None], LOW, HIGH, beyond_m=10.0)[0])
    tried = depth(a + SHARES * (b - a)).min()
    assert found - 1e-3 <= tried <= found + STEP


@given(point, point)
def test_far_from_a_box_the_distance_is_a_lower_bound(a: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    true = float(box_distances(a[None], b[None], LOW, HIGH, beyond_m=10.0)[0])
    bounded = float(box_distances(a[None], b[None], LOW, HIGH, beyond_m=0.2)[0])
    assert bounded <= true + 1e-3
    assert bounded == pytest.approx(true, abs=1e-3) or bounded > 0.2
