"""The enhanced matching method: thinning (eq. 3), and matching on flat bands."""

import numpy as np
import pytest

from recognition.parameters import ChainParameters
from recognition.shirakawa.enhanced_matching import EnhancedMatching, match_enhanced, thin, trim_at_intersections
from recognition.shirakawa.matching import match_points


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
