"""Contribution rates (eqs. 4 to 6) of known shapes, and the points of intersections."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from recognition.parameters import ChainParameters
from recognition.shirakawa.contribution_rate import contribution_rates, intersection_points

R = 0.0042
ARM = np.arange(-8, 9)[:, None] * 0.0005


def along(*directions: tuple[float, float, float]) -> np.ndarray:
    """Points every 0.5 mm up to 4 mm from the origin on both sides along each direction; the origin comes first."""
    arms = np.vstack([ARM[ARM[:, 0] != 0] * np.array(direction) for direction in directions])
    return np.vstack([np.zeros((1, 3)), arms])


ROTATIONS = st.integers(0, 2**32 - 1).map(lambda seed: Rotation.random(rng=np.random.default_rng(seed)).as_matrix())
POSITIONS = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array)


@settings(deadline=None)
@given(ROTATIONS, POSITIONS)
def test_known_shapes_have_known_rates_wherever_they_lie(turn: np.ndarray, position: np.ndarray) -> None:
    # Covariances of millimetres are 1e-5 m^2; metres away from the origin they keep ten digits.
    line, cross, star = (
        along((1, 0, 0)),
        along((1, 0, 0), (0, 1, 0)),
        along((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    )
    for points, rate in ((line, 1.0), (cross, 1 / 2), (star, 1 / 3)):
        assert contribution_rates(points @ turn.T + position, R)[0] == pytest.approx(rate, rel=1e-7)


def test_every_point_of_a_line_has_rate_1() -> None:
    np.testing.assert_allclose(contribution_rates(along((0.6, 0.0, 0.8)), R), 1.0, rtol=0, atol=1e-9)


def test_a_ball_has_rate_one_third() -> None:
    rng = np.random.default_rng(0)
    directions = rng.standard_normal((1500, 3))
    ball = directions / np.linalg.norm(directions, axis=1, keepdims=True) * R * rng.uniform(0, 1, (1500, 1)) ** (1 / 3)
    rate = contribution_rates(np.vstack([np.zeros((1, 3)), ball]), 1.001 * R)[0]
    # The largest of three variances, each known to sqrt(2 / 1500) = 4 %: a little above 1/3, never below.
    assert 1 / 3 <= rate < 0.36


def test_an_acute_cross_by_hand() -> None:
    # Strands at +-30 degrees: variances in the ratio cos^2 to sin^2, 3 to 1.
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    assert contribution_rates(along((c, s, 0), (c, -s, 0)), R)[0] == pytest.approx(0.75, rel=1e-9)


def test_random_points_by_brute_force() -> None:
    points = np.random.default_rng(1).uniform(0, 0.015, (150, 3)) + np.array([0.5, -0.3, 0.01])
    rates = contribution_rates(points, R)
    compared = 0
    for p, rate in zip(points, rates, strict=True):
        q = points[np.linalg.norm(points - p, axis=1) <= R]
        if len(q) == 1:
            assert rate == 1.0
            continue
        eigenvalues = np.abs(np.linalg.eigvalsh(np.cov(q.T, bias=True)))
        assert rate == pytest.approx(eigenvalues.max() / eigenvalues.sum(), rel=1e-8)
        compared += 1
    assert compared > 100


@pytest.mark.parametrize("position", [0.0, 0.3, -1.0])
def test_a_point_alone_or_repeated_has_no_width(position: float) -> None:
    np.testing.assert_array_equal(contribution_rates(np.full((1, 3), position), R), [1.0])
    apart = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]) + position
    np.testing.assert_array_equal(contribution_rates(apart, R), [1.0, 1.0])
    np.testing.assert_array_equal(contribution_rates(np.full((5, 3), position), R), np.ones(5))


def test_no_points_have_no_rates() -> None:
    assert contribution_rates(np.empty((0, 3)), R).shape == (0,)


def test_a_neighbourhood_below_the_threshold_makes_all_its_points_an_intersection(table_1: ChainParameters) -> None:
    # On a line every 2 mm: neighbours within r_s = 4.2 mm are two to either side.
    points = np.linspace((0.0, 0.0, 0.0), (0.016, 0.0, 0.0), 9)
    rho = np.ones(9)
    rho[4] = 0.89
    found = intersection_points(points, rho, table_1)
    assert np.flatnonzero(found).tolist() == [2, 3, 4, 5, 6]
    # rho_t itself is not less than rho_t.
    rho[4] = table_1.rho_t
    assert not intersection_points(points, rho, table_1).any()


def test_a_cross_is_an_intersection_in_its_middle_and_not_in_its_arms(table_1: ChainParameters) -> None:
    # Two lines of points every 0.5 mm.
    points = np.vstack(
        [np.linspace((-0.02, 0.0, 0.0), (0.02, 0.0, 0.0), 81), np.linspace((0.0, -0.02, 0.0), (0.0, 0.02, 0.0), 81)]
    )
    found = intersection_points(points, contribution_rates(points, table_1.r_s), table_1)
    distance = np.linalg.norm(points, axis=1)
    assert found[distance <= table_1.r_s].all()
    # A neighbourhood that reaches the other strand ends r_s from it; its points at most r_s farther.
    assert not found[distance > 2 * table_1.r_s].any()
