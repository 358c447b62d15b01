"""Each view is aligned to the nominal height and tilt of the table."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import rigid, transform_points
from recognition.parameters import ChainParameters
from recognition.preprocessing.table_plane import table_alignment


def table_points(
    height_m: float, slope_x: float, slope_y: float, half_m: tuple[float, float] = (0.2, 0.15)
) -> np.ndarray:
    """Return (4000, 3) points of the plane z = height + slope_x x + slope_y y."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(-1, 1, (4000, 2)) * half_m
    return np.column_stack([xy, height_m + xy @ (slope_x, slope_y)])


@pytest.mark.parametrize("table_z_m", [0.0, -0.35])
@pytest.mark.parametrize(
    ("height_m", "slope_x", "slope_y"),
    [(0.0, 0.0, 0.0), (0.0025, 0.0, 0.0), (-0.003, 0.008, -0.005), (0.001, -0.012, 0.0)],
)
def test_nominal_height_and_tilt_are_recovered(
    table_1: ChainParameters, table_z_m: float, height_m: float, slope_x: float, slope_y: float
) -> None:
    points = table_points(table_z_m + height_m, slope_x, slope_y)
    T = rigid(table_alignment(points, table_z_m, table_1), "T_table_alignment")
    # Exact but for the sine used as the angle: 0.012^3 / 6 over 0.25 m is 0.1 um.
    np.testing.assert_allclose(transform_points(T, points)[:, 2], table_z_m, rtol=0, atol=1e-6)
    # The table determines neither yaw nor horizontal shift: neither is corrected at its centre.
    assert abs(Rotation.from_matrix(T[:3, :3]).as_rotvec()[2]) < 1e-12
    middle = points.mean(axis=0)
    np.testing.assert_allclose(transform_points(T, middle[None])[0, :2], middle[:2], rtol=0, atol=1e-10)


def test_the_string_does_not_pull_the_plane_up(table_1: ChainParameters) -> None:
    table = table_points(0.001, 0.004, 0.0)
    rng = np.random.default_rng(6)
    u, across = rng.uniform(-0.15, 0.15, 1500), rng.uniform(-1, 1, 1500)
    # The visible upper half of a string along x that lies on the table.
    height = table_1.r * (1 + np.sqrt(1 - across**2))
    string = np.column_stack([u, 0.05 + table_1.r * across, 0.001 + 0.004 * u + height])
    noise = np.array([0.0, 0.0, 0.0005]) * rng.standard_normal((5500, 3))
    T = table_alignment(np.vstack([table, string]) + noise, 0.0, table_1)
    # 0.5 mm of noise over 4000 points is 0.01 mm; the string's flanks below the threshold may add some.
    np.testing.assert_allclose(transform_points(T, table)[:, 2], 0.0, rtol=0, atol=0.0001)


def test_noise_averages_out(table_1: ChainParameters) -> None:
    points = table_points(-0.002, 0.0, 0.006)
    noisy = points + np.array([0.0, 0.0, 0.001]) * np.random.default_rng(7).standard_normal(points.shape)
    T = table_alignment(noisy, 0.0, table_1)
    # 1 mm over 4000 points: 0.016 mm at the centre, twice that at the edge; four sigma, rounded up.
    np.testing.assert_allclose(transform_points(T, points)[:, 2], 0.0, rtol=0, atol=0.00015)


def test_no_correction_without_a_visible_table(table_1: ChainParameters) -> None:
    points = table_points(0.001, 0.0, 0.0)
    few = points[:80]
    string_only = points + np.array([0.0, 0.0, 0.008])
    mostly_else = np.vstack([points[:500], points + np.array([0.0, 0.0, 0.05])])
    narrow = table_points(0.001, 0.0, 0.0, half_m=(0.2, 0.01))
    for cloud in (np.empty((0, 3)), few, string_only, mostly_else, narrow):
        np.testing.assert_array_equal(table_alignment(cloud, 0.0, table_1), np.eye(4))


@pytest.mark.parametrize(
    ("height_m", "slope_x", "slope_y"),
    [(0.0048, 0.0, 0.0), (-0.006, 0.0, 0.0), (0.0, 0.025, 0.0), (0.0, 0.016, -0.016)],
)
def test_no_correction_beyond_the_limit_of_a_pose_error(
    table_1: ChainParameters, height_m: float, slope_x: float, slope_y: float
) -> None:
    points = table_points(height_m, slope_x, slope_y)
    np.testing.assert_array_equal(table_alignment(points, 0.0, table_1), np.eye(4))


@pytest.mark.parametrize("noise_m", [0.001, 0.002, 0.003])
def test_noise_is_not_taken_for_a_plane_below_the_table(table_1: ChainParameters, noise_m: float) -> None:
    """With 2 mm, a quarter of the points is as far below the plane as points of another plane would be."""
    points = table_points(0.001, 0.0, 0.0)
    points[:, 2] += np.random.default_rng(1).normal(0, noise_m, len(points))
    T = table_alignment(points, 0.0, table_1)
    assert abs(transform_points(T, np.array([[0.0, 0.0, 0.001]]))[0, 2]) < 0.0004
