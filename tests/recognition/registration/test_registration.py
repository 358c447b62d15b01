"""Registration of views with known pose errors."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from calibration.geometry.transforms import from_rotation_vector, inverse, transform_points
from cell.simulation.offline_scan import simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.ingestion.view_ingestion import ingest_views
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.target_cloud import Scene
from recognition.registration.correspondences import compared_earlier_views, find_correspondences
from recognition.registration.pose_prior import PoseSigmas, twist_about
from recognition.registration.registration import MAX_HAND_EYE_ERROR_SIGMA, Registration, register, transform_cloud

S = np.arange(0.0, 0.24, 0.0008)
# An S of two arcs of 60 mm radius: bent in the plane, so that views cannot slide along it.
HEADING = np.where(S < 0.12, S / 0.06, 4.0 - S / 0.06)
BENT = np.column_stack([np.cumsum(np.cos(HEADING)), np.cumsum(np.sin(HEADING)), np.zeros_like(S)]) * 0.0008
STRAIGHT = np.column_stack([S - 0.12, np.zeros_like(S), np.zeros_like(S)])
SIDES = [(np.radians(low), np.radians(low + 140)) for low in (10, 30, 50, -10, 20, 40)]


def views_of(tube: Callable, curve: np.ndarray, r: float, twists: np.ndarray) -> list[NormalCloud]:
    """Return one cloud per twist. Each shows another side of the string and is moved about the middle of the curve."""
    clouds = []
    for k, twist in enumerate(twists):
        rng = np.random.default_rng(k)
        # Not the same points in every view.
        shifted = curve + np.gradient(curve, axis=0) * rng.uniform(-0.5, 0.5)
        points, normals = tube(shifted, r, *SIDES[k % len(SIDES)], around=18)
        cloud = NormalCloud(k, points + 0.0001 * rng.standard_normal(points.shape), normals, np.eye(4))
        clouds.append(replace(transform_cloud(cloud, about(twist, curve.mean(axis=0))), T_correction=np.eye(4)))
    return clouds


def about(twist: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the transform that rotates about `centre` by a rotation vector and translates."""
    T = from_rotation_vector(twist[3:], twist[:3])
    T[:3, 3] += centre - T[:3, :3] @ centre
    return T


def off_surface(points: np.ndarray, curve: np.ndarray, r: float) -> np.ndarray:
    """Return the distance (N,) of each point from the true tube. The curve steps of 0.8 mm add at most 0.02 mm."""
    return np.abs(KDTree(curve).query(points)[0] - r)


def surface_error(registration: Registration, curve: np.ndarray, r: float) -> float:
    return float(np.mean([off_surface(cloud.points, curve, r).mean() for cloud in registration.clouds]))


def pose_errors(seed: int, count: int) -> np.ndarray:
    """Draw twists of the size of robot and calibration errors: 1 mrad and 0.7 mm per axis."""
    return np.random.default_rng(seed).standard_normal((count, 6)) * np.repeat([0.001, 0.0007], 3)


def test_a_bent_string_is_merged_better_than_by_the_hand_eye_poses(table_1: ChainParameters, tube: Callable) -> None:
    gains = []
    for seed in range(4):
        clouds = views_of(tube, BENT, table_1.r, pose_errors(seed, 6))
        by_pose = float(np.mean([off_surface(cloud.points, BENT, table_1.r).mean() for cloud in clouds]))
        registered = surface_error(register(clouds, table_1), BENT, table_1.r)
        gains.append(registered / by_pose)
    # Never worse. No registration can see the error that all views share (1 / sqrt 6 of it, 40 %).
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
    # Both heights have the same sigma, so that each view moves halfway. Most of the 2 mm between them is removed.
    assert 0.0012 < heights[0] - heights[1] < 0.0021
    assert surface_error(registration, BENT, table_1.r) < 0.5 * np.mean(
        [off_surface(cloud.points, BENT, table_1.r).mean() for cloud in clouds]
    )


def test_the_common_motion_is_removed(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, pose_errors(9, 5))
    centre = np.vstack([cloud.points for cloud in clouds]).mean(axis=0)
    registration = register(clouds, table_1)
    T_corrections = [cloud.T_correction for cloud in registration.clouds]
    shifted = [transform_points(T, centre[None])[0] - centre for T in T_corrections]
    turned = [Rotation.from_matrix(T[:3, :3]).as_rotvec() for T in T_corrections]
    assert np.linalg.norm(shifted, axis=1).max() > 0.0001
    # Zero except for rounding: the merged cloud stays at the mean of the hand-eye poses.
    np.testing.assert_allclose(np.mean(shifted, axis=0), 0.0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.mean(turned, axis=0), 0.0, rtol=0, atol=1e-9)


def test_each_view_is_reported_in_the_order_of_its_index(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, pose_errors(3, 3))
    clouds[1] = replace(clouds[1], points=clouds[1].points[:900], normals=clouds[1].normals[:900])
    registration = register([clouds[2], clouds[1], clouds[0]], table_1)
    assert [view.index for view in registration.views] == [0, 1, 2]
    assert [cloud.view for cloud in registration.clouds] == [0, 1, 2]
    for cloud, view, before in zip(registration.clouds, registration.views, clouds, strict=True):
        assert (view.used, view.reason, view.points) == (True, None, len(before.points))
        # The reported correction is the one that was made.
        middle = cloud.points.mean(axis=0)
        was = transform_points(inverse(cloud.T_correction), middle[None])[0]
        assert view.correction_m == pytest.approx(np.linalg.norm(middle - was), abs=1e-12)
        assert view.rms_m is not None
        # Points lie within a voxel's reach (r / 3 across) of its mean.
        assert 0 < view.rms_m < table_1.r / 3


@pytest.mark.parametrize("along_m", [0.002, -0.003])
def test_a_straight_string_is_not_slid_along_its_axis(table_1: ChainParameters, tube: Callable, along_m: float) -> None:
    twists = np.zeros((2, 6))
    twists[1, 3:] = (along_m, 0.0006, 0.0)
    registration = register(views_of(tube, STRAIGHT, table_1.r, twists), table_1)
    first, second = (twist_about(cloud.T_correction, STRAIGHT.mean(axis=0)) for cloud in registration.clouds)
    # Nine tenths of the offset across the string are removed. Along it the surfaces show nothing.
    assert second[4] - first[4] == pytest.approx(-0.0006, abs=0.00006)
    assert max(abs(first[3]), abs(second[3])) < 0.00005
    # The covariance agrees: along the string it is that of the poses alone, across it far smaller.
    difference = np.array([1.0, -1.0])
    along, across = (
        np.sqrt(difference @ registration.covariance[np.ix_([k, 6 + k], [k, 6 + k])] @ difference) for k in (3, 4)
    )
    assert along == pytest.approx(np.sqrt(2) * PoseSigmas().robot_m, rel=0.05)
    assert across < along / 4


def test_registered_views_are_never_worse_and_as_good_as_their_covariance(
    table_1: ChainParameters, tube: Callable
) -> None:
    # Independent errors with the robot sigmas of the prior.
    sigma = np.repeat([PoseSigmas().robot_rad, PoseSigmas().robot_m], 3)
    centre = BENT.mean(axis=0)
    before, after, squared = [], [], []
    for seed in range(30):
        count = 2 + seed % 3
        twists = np.random.default_rng(100 + seed).standard_normal((count, 6)) * sigma
        registration = register(views_of(tube, BENT, table_1.r, twists), table_1)
        left = np.array(
            [
                twist_about(cloud.T_correction @ about(twist, centre), registration.centre)
                for cloud, twist in zip(registration.clouds, twists, strict=True)
            ]
        )
        given = np.array([twist_about(about(twist, centre), registration.centre) for twist in twists])
        before.append(apart(given))
        after.append(apart(left))
        # The first view against the second, in units of its covariance.
        D = np.hstack([np.eye(6), -np.eye(6), np.zeros((6, 6 * (count - 2)))])
        difference = left[0] - left[1]
        squared.append(difference @ np.linalg.solve(D @ registration.covariance @ D.T, difference) / 6)
    assert (np.array(after) < np.array(before)).all()
    assert np.mean(after) < 0.3 * np.mean(before)
    # The errors of these points are independent. The covariance assumes correlated errors of a camera and is larger.
    assert 0.05 < np.mean(squared) < 1.2


def test_many_views_are_as_good_as_their_covariance(table_1: ChainParameters, tube: Callable) -> None:
    # Each of 24 views is compared with about eight others. It is known as well as one of eight views, relative to the
    # other views.
    sigma = np.repeat([PoseSigmas().robot_rad, PoseSigmas().robot_m], 3)
    centre = BENT.mean(axis=0)
    spread, squared = {}, []
    for count in (8, 24):
        twists = np.random.default_rng(count).standard_normal((count, 6)) * sigma
        registration = register(views_of(tube, BENT, table_1.r, twists), table_1)
        relative = np.kron(np.eye(count) - 1 / count, np.eye(6))
        covariance = relative @ registration.covariance @ relative.T
        spread[count] = np.sqrt(np.diag(covariance).reshape(count, 6)[:, 3:].sum(axis=1).mean())
        left = relative @ np.concatenate(
            [
                twist_about(cloud.T_correction @ about(twist, centre), registration.centre)
                for cloud, twist in zip(registration.clouds, twists, strict=True)
            ]
        )
        squared.append(left @ np.linalg.pinv(covariance, rcond=1e-9) @ left / (6 * (count - 1)))
    assert spread[24] == pytest.approx(spread[8], rel=0.25)
    assert 0.05 < min(squared) < max(squared) < 1.2


def test_views_that_arrive_in_another_order_are_registered_as_well(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, pose_errors(5, 12))
    arrived = [clouds[k] for k in np.random.default_rng(0).permutation(12)]
    pairs = []
    for k, cloud in enumerate(arrived):
        earlier = [arrived[j] for j in compared_earlier_views(arrived[: k + 1])]
        pairs += find_correspondences(cloud, earlier, table_1)
    registration = register(arrived, table_1, pairs)
    assert [cloud.view for cloud in registration.clouds] == list(range(12))
    in_order = register(clouds, table_1)
    assert surface_error(registration, BENT, table_1.r) == pytest.approx(
        surface_error(in_order, BENT, table_1.r), rel=0.1
    )


def apart(twists: np.ndarray) -> float:
    """Return the rms distance (metres) between the views of a point 0.1 m from the centre."""
    relative = (twists - twists.mean(axis=0)) * np.repeat([0.1, 1.0], 3)
    return float(np.sqrt((relative**2).sum(axis=1).mean()))


def test_a_calibration_that_has_drifted_is_a_finding(table_1: ChainParameters) -> None:
    scan = simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, errors=NO_ERRORS, views=6)
    scene = Scene(0.0, scan.header.workspace_m)
    for drift_m, turn_rad, has_drifted in (
        (0.0007, 0.0, False),
        (0.0, 0.003, False),
        (0.004, 0.0, True),
        (0.0, 0.03, True),
    ):
        T_error = from_rotation_vector((drift_m, 0, 0), (0, 0, turn_rad))
        views = [replace(view, T_flange_camera=view.T_flange_camera @ T_error) for view in scan.views]
        ingested = ingest_views(views, table_1, scene)
        registration = register(ingested.clouds, table_1, ingested.correspondences)
        assert all(view.used for view in registration.views)
        drift = registration.hand_eye_drift
        assert (drift is not None) == has_drifted
        if drift is not None:
            assert (drift.code, drift.severity, drift.limit) == ("calibration-drift", "doubt", MAX_HAND_EYE_ERROR_SIGMA)
            assert drift.value is not None
            assert drift.value > MAX_HAND_EYE_ERROR_SIGMA
            found = re.match(
                r"the calibration has drifted: .* with the camera (.+) mm and (.+) degrees from", drift.message
            )
            assert found is not None
            # A shift across the line of sight resembles a rotation of the camera. The message has the most likely
            # mixture: half to all of the true error.
            if drift_m:
                assert 0.5 < float(found[1]) / 1000 / drift_m < 1.0
            else:
                assert 0.5 < np.radians(float(found[2])) / turn_rad < 1.0


def test_given_correspondences_are_used(table_1: ChainParameters, tube: Callable) -> None:
    clouds = views_of(tube, BENT, table_1.r, pose_errors(5, 3))
    pairs = [pair for k in range(3) for pair in find_correspondences(clouds[k], clouds[:k], table_1)]
    given, found = register(clouds, table_1, pairs), register(clouds, table_1)
    np.testing.assert_array_equal(given.points, found.points)
    np.testing.assert_array_equal(given.covariance, found.covariance)


def test_views_without_overlap_stay_where_they_are(table_1: ChainParameters, tube: Callable) -> None:
    first, second = views_of(tube, BENT, table_1.r, np.zeros((2, 6)))
    elsewhere = transform_cloud(second, from_rotation_vector((0, 0, 0.1), (0, 0, 0)))
    registration = register([first, replace(elsewhere, T_correction=np.eye(4))], table_1)
    for cloud in registration.clouds:
        np.testing.assert_allclose(cloud.T_correction, np.eye(4), rtol=0, atol=1e-12)
    assert [view.fitness for view in registration.views] == [0.0, 0.0]
    assert [view.rms_m for view in registration.views] == [None, None]


def test_a_cloud_is_moved_with_all_that_belongs_to_it() -> None:
    T_base_camera = from_rotation_vector((0, 0, 0.4), (np.pi, 0, 0))
    cloud = NormalCloud(
        0, np.array([[1.0, 0, 0], [2.0, 0, 0]]), np.array([[1.0, 0, 0], [0, 0, 1.0]]), np.eye(4), T_base_camera
    )
    turned = transform_cloud(cloud, from_rotation_vector((0, 0, 0.5), (0, 0, np.pi / 2)))
    np.testing.assert_allclose(turned.points, [(0, 1, 0.5), (0, 2, 0.5)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(turned.normals, [(0, 1, 0), (0, 0, 1)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(transform_points(turned.T_correction, cloud.points), turned.points, rtol=0, atol=1e-15)
    assert turned.T_base_camera is not None
    np.testing.assert_allclose(turned.T_base_camera[:3, 3], (0, 0, 0.9), rtol=0, atol=1e-15)
    # A further correction comes on top.
    back = transform_cloud(turned, from_rotation_vector((0, 0, 0), (0, 0, -np.pi / 2)))
    np.testing.assert_allclose(back.T_correction, from_rotation_vector((0, 0, 0.5), (0, 0, 0)), rtol=0, atol=1e-15)
    # The tree of the points is its own.
    assert turned.tree.query([0, 1, 0.5])[0] < 1e-12 < cloud.tree.query([0, 1, 0.5])[0]
