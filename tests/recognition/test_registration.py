"""Merging views whose poses are off by a known error."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from calibration.transforms import from_rotation_vector, inverse, transform_points
from recognition.normals import NormalCloud
from recognition.parameters import ChainParameters
from recognition.registration import (
    MAX_CORRECTION_SIGMA,
    POSE_SIGMA,
    Registration,
    corrected,
    correction_onto,
    merge,
    register,
)

S = np.arange(0.0, 0.24, 0.0008)
# An S of two arcs of 60 mm radius: bent in the plane, so that views cannot slide along it.
HEADING = np.where(S < 0.12, S / 0.06, 4.0 - S / 0.06)
BENT = np.column_stack([np.cumsum(np.cos(HEADING)), np.cumsum(np.sin(HEADING)), np.zeros_like(S)]) * 0.0008
STRAIGHT = np.column_stack([S - 0.12, np.zeros_like(S), np.zeros_like(S)])
SIDES = [(np.radians(low), np.radians(low + 140)) for low in (10, 30, 50, -10, 20, 40)]


def views_of(tube: Callable, curve: np.ndarray, r: float, twists: np.ndarray) -> list[NormalCloud]:
    """One cloud a twist: another side of the string each, and moved by it about the curve's middle."""
    clouds = []
    for k, twist in enumerate(twists):
        rng = np.random.default_rng(k)
        # Not the same points in every view.
        shifted = curve + np.gradient(curve, axis=0) * rng.uniform(-0.5, 0.5)
        points, normals = tube(shifted, r, *SIDES[k], around=18)
        cloud = NormalCloud(k, points + 0.0001 * rng.standard_normal(points.shape), normals, np.eye(4))
        clouds.append(replace(corrected(cloud, twist, curve.mean(axis=0)), T_correction=np.eye(4)))
    return clouds


def off_surface(points: np.ndarray, curve: np.ndarray, r: float) -> np.ndarray:
    """(N,) distance of each point from the true tube; the curve's steps of 0.8 mm make at most 0.02 mm of it."""
    return np.abs(KDTree(curve).query(points)[0] - r)


def surface_error(registration: Registration, curve: np.ndarray, r: float) -> float:
    return float(np.mean([off_surface(cloud.points, curve, r).mean() for cloud in registration.clouds]))


def pose_errors(seed: int, count: int) -> np.ndarray:
    """Twists as robot and calibration err: 1 mrad and 0.7 mm about each axis."""
    return np.random.default_rng(seed).standard_normal((count, 6)) * np.repeat([0.001, 0.0007], 3)


def test_a_bent_string_is_merged_better_than_by_the_hand_eye_poses(table_1: ChainParameters, tube: Callable) -> None:
    gains = []
    for seed in range(4):
        clouds = views_of(tube, BENT, table_1.r, pose_errors(seed, 6))
        by_pose = float(np.mean([off_surface(cloud.points, BENT, table_1.r).mean() for cloud in clouds]))
        registered = surface_error(register(clouds, table_1), BENT, table_1.r)
        gains.append(registered / by_pose)
    # Never worse; what all views have in common (1 / sqrt 6 of the error, 40 %) no registration can see.
    assert max(gains) < 1.0
    assert np.mean(gains) < 0.75


def test_exact_poses_are_left_alone(table_1: ChainParameters, tube: Callable) -> None:
    registration = register(views_of(tube, BENT, table_1.r, np.zeros((3, 6))), table_1)
    for view in registration.views:
        assert view.correction_m is not None
        assert view.correction_rad is not None
        # A tenth of the poses' own sigma (1 mm): what noise of 0.1 mm and other samples of the surface may do.
        assert view.correction_m < 0.0001
        assert view.correction_rad < 0.0005
        assert view.fitness == 1.0


def test_views_that_differ_are_brought_together(table_1: ChainParameters, tube: Callable) -> None:
    aside = np.array([0, 0, 0, 0, 0, 0.001])
    clouds = views_of(tube, BENT, table_1.r, np.array([-aside, aside]))
    registration = register(clouds, table_1)
    heights = [transform_points(cloud.T_correction, np.zeros((1, 3)))[0, 2] for cloud in registration.clouds]
    # Both know their height alike well, so they meet half way, by most of the 2 mm between them.
    assert 0.0012 < heights[0] - heights[1] < 0.0021
    assert surface_error(registration, BENT, table_1.r) < 0.5 * np.mean(
        [off_surface(cloud.points, BENT, table_1.r).mean() for cloud in clouds]
    )


@pytest.mark.parametrize("along_m", [0.002, -0.003])
def test_a_straight_string_is_not_slid_along_its_axis(table_1: ChainParameters, tube: Callable, along_m: float) -> None:
    twists = np.zeros((2, 6))
    twists[1, 3:] = (along_m, 0.0006, 0.0)
    first, second = views_of(tube, STRAIGHT, table_1.r, twists)
    x = correction_onto([first], second, STRAIGHT.mean(axis=0), table_1)
    # Across it is put right, at least half of it (the pose has a say); along it there is nothing to see.
    assert -0.0008 < x[4] < -0.0003
    assert abs(x[3]) < 0.00005
    registration = register([first, second], table_1)
    for cloud in registration.clouds:
        assert abs(cloud.T_correction[0, 3]) < 0.00005


def test_a_correction_beyond_what_calibration_explains_is_refused(tube: Callable) -> None:
    # A thick string, so that ICP finds its way back over a displacement of 6 mm: six sigma of the pose.
    parameters = ChainParameters.for_radius(0.015)
    for aside, refused in ((0.002, False), (0.006, True)):
        twists = np.zeros((2, 6))
        twists[1, 5] = aside
        first, second = views_of(tube, BENT * 3, parameters.r, twists)
        x = correction_onto([first], second, BENT.mean(axis=0) * 3, parameters)
        assert (x == 0).all() == refused
        assert (np.abs(x) <= MAX_CORRECTION_SIGMA * POSE_SIGMA).all()


def test_too_few_matches_decide_nothing(table_1: ChainParameters, tube: Callable) -> None:
    twists = np.zeros((2, 6))
    twists[1, 5] = 0.001
    first, second = views_of(tube, BENT, table_1.r, twists)
    few = replace(second, points=second.points[:40], normals=second.normals[:40])
    np.testing.assert_array_equal(correction_onto([first], few, BENT.mean(axis=0), table_1), np.zeros(6))
    elsewhere = replace(second, points=second.points + np.array([0, 0, 0.1]))
    np.testing.assert_array_equal(correction_onto([first], elsewhere, BENT.mean(axis=0), table_1), np.zeros(6))


def test_the_common_motion_is_removed(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, pose_errors(9, 5))
    centre = np.vstack([cloud.points for cloud in clouds]).mean(axis=0)
    registration = register(clouds, table_1)
    T_corrections = [cloud.T_correction for cloud in registration.clouds]
    moved = [transform_points(T, centre[None])[0] - centre for T in T_corrections]
    turned = [Rotation.from_matrix(T[:3, :3]).as_rotvec() for T in T_corrections]
    assert np.linalg.norm(moved, axis=1).max() > 0.0001
    # Zero but for roundings: the merged cloud stays where the hand-eye poses together put it.
    np.testing.assert_allclose(np.mean(moved, axis=0), 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.mean(turned, axis=0), 0.0, rtol=0, atol=1e-12)


def test_each_view_is_reported_in_the_order_of_its_index(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, pose_errors(3, 3))
    clouds[1] = replace(clouds[1], points=clouds[1].points[:900], normals=clouds[1].normals[:900])
    registration = register([clouds[2], clouds[1], clouds[0]], table_1)
    assert [view.index for view in registration.views] == [0, 1, 2]
    assert [cloud.view for cloud in registration.clouds] == [0, 1, 2]
    for cloud, view, before in zip(registration.clouds, registration.views, clouds, strict=True):
        assert (view.used, view.reason, view.points) == (True, None, len(before.points))
        # The correction told is the one made.
        middle = cloud.points.mean(axis=0)
        was = transform_points(inverse(cloud.T_correction), middle[None])[0]
        assert view.correction_m == pytest.approx(np.linalg.norm(middle - was), abs=1e-12)
        assert view.rms_m is not None
        # Points lie within a voxel's reach (r / 3 across) of its mean.
        assert 0 < view.rms_m < table_1.r / 3


def test_a_cloud_is_moved_about_the_centre(table_1: ChainParameters) -> None:
    cloud = NormalCloud(
        0, np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), np.array([[1.0, 0, 0], [0, 0, 1.0]]), np.eye(4)
    )
    moved = corrected(cloud, np.array([0, 0, np.pi / 2, 0, 0, 0.5]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(moved.points, [(1, 0, 0.5), (1, 1, 0.5)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(moved.normals, [(0, 1, 0), (0, 0, 1)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(transform_points(moved.T_correction, cloud.points), moved.points, rtol=0, atol=1e-15)
    # A further correction comes on top.
    back = corrected(moved, np.array([0, 0, -np.pi / 2, 0, 0, 0]), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(back.T_correction, from_rotation_vector((0, 0, 0.5), (0, 0, 0)), rtol=0, atol=1e-15)


def test_merging_thins_drops_outliers_and_keeps_unit_normals(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, np.zeros((3, 6)))
    far = NormalCloud(9, np.array([[0.0, 0.0, 0.08]]), np.array([[0.0, 0.0, 1.0]]), np.eye(4))
    points, normals = merge([*clouds, far], table_1)
    assert points.shape == normals.shape
    assert len(points) < sum(len(cloud.points) for cloud in clouds) / 4
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0, atol=1e-12)
    assert points[:, 2].max() < 0.01
    # Means over voxels of r / 3 lie under the surface by up to the sagitta of their diagonal, r / 24.
    assert off_surface(points, BENT, table_1.r).max() < table_1.r / 24 + 0.0004


def test_a_point_with_opposite_normals_has_no_side(table_1: ChainParameters) -> None:
    x, y = np.meshgrid(np.linspace(0, 0.022, 12), np.linspace(0, 0.022, 12))
    sheet = np.column_stack([x.ravel(), y.ravel(), np.zeros(144)])
    up = np.tile((0.0, 0.0, 1.0), (144, 1))
    down = up.copy()
    # Half of the second view's sheet is seen from below.
    down[sheet[:, 0] > 0.011] *= -1
    points, normals = merge([NormalCloud(0, sheet, up, np.eye(4)), NormalCloud(1, sheet, down, np.eye(4))], table_1)
    assert points[:, 0].max() < 0.011
    np.testing.assert_allclose(normals, np.tile((0.0, 0.0, 1.0), (len(points), 1)), rtol=0, atol=1e-12)
