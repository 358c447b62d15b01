"""The enhanced matching method: thinning (eq. 3), contribution rates (eqs. 4 to 6), and matching on flat bands."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from recognition.parameters import ChainParameters
from recognition.shirakawa.enhanced_matching import (
    EnhancedMatching,
    contribution_rates,
    intersection_points,
    match_enhanced,
    thin,
    trim_at_intersections,
)
from recognition.shirakawa.matching import match_points

R = 0.0042
ARM = np.arange(-8, 9)[:, None] * 0.0005


def test_eq_3_by_a_loop(table_1: ChainParameters) -> None:
    points = np.random.default_rng(3).uniform(0, 0.02, (120, 3))
    thinned = thin(points, table_1)
    for p, a in zip(points, thinned, strict=True):
        q = [other for other in points if np.linalg.norm(other - p) <= table_1.r_c]
        np.testing.assert_allclose(a, sum(q) / len(q), rtol=0, atol=1e-16)


def test_thinning_makes_a_band_narrower_and_keeps_its_line(table_1: ChainParameters) -> None:
    rng = np.random.default_rng(4)
    x = np.linspace(0, 0.1, 3000)
    band = np.column_stack([x, rng.uniform(-0.001, 0.001, 3000), np.full(3000, 0.0042)])
    thinned = thin(band, table_1)
    # Some 250 neighbours of 0.58 mm spread: their mean scatters by 0.04 mm. Five of that.
    assert np.abs(thinned[:, 1]).max() < 0.0002
    assert np.abs(thinned[:, 2] - 0.0042).max() < 1e-12


def test_thinning_keeps_a_point_alone(table_1: ChainParameters) -> None:
    np.testing.assert_array_equal(thin(np.array([[0.1, 0.2, 0.3]]), table_1), [[0.1, 0.2, 0.3]])
    assert thin(np.empty((0, 3)), table_1).shape == (0, 3)


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


def band(angle_rad: float, width_m: float, seed: int, half_length_m: float = 0.08) -> np.ndarray:
    """(500, 3) points of a band through the origin in the plane z = 0."""
    rng = np.random.default_rng(seed)
    along, across = rng.uniform(-half_length_m, half_length_m, 500), rng.uniform(-0.5, 0.5, 500) * width_m
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([c * along - s * across, s * along + c * across, np.zeros(500)])


def cross(angle_rad: float = np.pi / 2, seed: int = 0) -> np.ndarray:
    return np.vstack([band(0.0, 0.001, seed), band(angle_rad, 0.001, seed + 100)])


def arms(found: EnhancedMatching, points: np.ndarray) -> list[np.ndarray]:
    return [points[segment] for segment in found.segments if len(segment) > 3]


@pytest.mark.parametrize("angle", [60, 90])
@pytest.mark.parametrize("seed", range(3))
def test_a_flat_cross_has_one_centre_in_its_middle_and_four_arms(
    table_1: ChainParameters, angle: int, seed: int
) -> None:
    points = cross(np.radians(angle), seed)
    found = match_enhanced(points, table_1)
    assert found.bifurcation_centres.shape == (1, 3)
    # Targets are r_n to r_f apart, so the one with the largest R_c may be r_n off.
    assert np.linalg.norm(found.bifurcation_centres[0]) <= table_1.r_n
    four = arms(found, points)
    assert len(four) == 4
    angles = []
    for arm in four:
        distance = np.linalg.norm(arm, axis=1)
        # From beyond the inner sphere to within r_n of the arm's end, whose outermost point is some tenths of a
        # millimetre short of it.
        assert np.linalg.norm(arm - found.bifurcation_centres[0], axis=1).min() >= table_1.r_cn
        assert distance.max() > 0.079 - table_1.r_n
        far = arm[distance.argmax()]
        angles.append(np.degrees(np.arctan2(far[1], far[0])) % 360)
        # It stays on its own arm: the band is 1 mm wide.
        across = arm - np.outer(arm @ far, far) / (far @ far)
        assert np.linalg.norm(across, axis=1).max() < 0.0015
    # An end within the band's width of 0.5 mm is within a degree of the arm's direction.
    np.testing.assert_allclose(
        np.sort((np.array(angles) + 10) % 360 - 10), np.sort([0, angle, 180, 180 + angle]), atol=1
    )


def test_the_matching_method_does_not_find_these_arms(table_1: ChainParameters) -> None:
    points = cross()
    assert sum(len(segment) > 3 for segment in match_points(points, table_1)) != 4


def test_the_measures_of_every_point_are_returned(table_1: ChainParameters) -> None:
    points = cross()
    found = match_enhanced(points, table_1)
    distance = np.linalg.norm(points, axis=1)
    assert found.rho.shape == found.R_c.shape == found.in_intersection.shape == (1000,)
    # Equal bands across each other: 1/2 in the middle, nearly 1 on the arms (1 mm wide, 8.4 mm long).
    assert found.rho[distance < 0.001].max() < 0.6
    assert found.rho[(distance > 0.02) & (distance < 0.07)].min() > 0.9
    assert found.in_intersection[distance < 0.004].all()
    assert not found.in_intersection[(distance > 0.02) & (distance < 0.07)].any()
    assert found.R_c[distance < 0.002].min() > table_1.R_t
    assert found.R_c[(distance > 0.03) & (distance < 0.07)].max() == 0.0


def test_a_line_has_no_centre_and_one_segment(table_1: ChainParameters) -> None:
    points = band(0.3, 0.0005, 7)
    found = match_enhanced(points, table_1)
    assert len(found.segments) == 1
    assert found.bifurcation_centres.shape == (0, 3)
    assert np.ptp(points[found.segments[0]] @ (np.cos(0.3), np.sin(0.3), 0)) > 0.16 - 2 * table_1.r_n


def test_segments_end_outside_intersections(table_1: ChainParameters) -> None:
    # Every 4 mm along x; r_cn = 12.6 mm about the centre at 40 mm.
    points = np.linspace((0.0, 0.0, 0.0), (0.08, 0.0, 0.0), 21)
    centre = np.array([[0.04, 0.0, 0.0]])
    segments = [[0, 1, 2, 5, 7, 8, 9], [10, 9, 8], [12, 14, 15], list(range(21))]
    expected = [[0, 1, 2, 5], [14, 15], list(range(21))]
    assert trim_at_intersections(points, segments, centre, table_1) == expected
    assert trim_at_intersections(points, segments, np.empty((0, 3)), table_1) == segments


def test_no_point_is_in_two_segments_and_none_stays_connectable(table_1: ChainParameters) -> None:
    points = cross(np.radians(75), 4)
    found = match_enhanced(points, table_1)
    linked = [i for segment in found.segments for i in segment]
    assert len(linked) == len(set(linked))
    to_linked = np.linalg.norm(points[:, None] - points[linked][None], axis=2).min(axis=1)
    to_centre = np.linalg.norm(points[:, None] - found.bifurcation_centres[None], axis=2).min(axis=1)
    assert ((to_linked <= table_1.r_n) | (to_centre <= table_1.r_cn)).all()


def test_no_points_have_no_segments(table_1: ChainParameters) -> None:
    found = match_enhanced(np.empty((0, 3)), table_1)
    assert found.segments == []
    assert found.bifurcation_centres.shape == (0, 3)
