"""Observations from which no calibration can be solved, each with its own code and a message that names the view."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.errors import HandEyeInputError
from calibration.geometry.se3 import pose_from_twist
from calibration.geometry.transforms import from_rotation_vector
from calibration.input_checks.motion_diversity import motion_diversity
from calibration.input_checks.observations import (
    check_camera_moved,
    check_observations,
    enough_corners,
    pose_from_vector,
)
from calibration.observations import Observations
from tests.calibration.board_views import BOARD, orbit_plan, realistic_plan, record, with_poses

GOOD = record(seed=1, count=12, plan=realistic_plan)


def with_view(index: int, **changes: Any) -> Observations:
    views = list(GOOD.observations.views)
    views[index] = replace(views[index], **changes)
    return replace(GOOD.observations, views=tuple(views))


def refused(observations: Observations) -> HandEyeInputError:
    with pytest.raises(HandEyeInputError) as caught:
        check_observations(observations)
    return caught.value


def turned(T: np.ndarray, rotations: Rotation) -> np.ndarray:
    """Return `T` (N, 4, 4) with other rotations."""
    result = T.copy()
    result[:, :3, :3] = rotations.as_matrix()
    return result


def test_good_views_pass():
    check_observations(GOOD.observations)
    check_camera_moved(GOOD.T_camera_board)


@pytest.mark.parametrize("mounting", ["eye-in-hand", "eye-to-hand"])
@pytest.mark.parametrize("seed", range(5))
def test_an_orbit_rotates_about_several_axes(mounting, seed):
    check_observations(record(seed, count=12, plan=orbit_plan, mounting=mounting).observations)


def test_nan_in_a_pose_names_the_view():
    T = GOOD.T_base_flange[3].copy()
    T[0, 3] = np.nan
    error = refused(with_view(3, T_base_flange=T))
    assert error.slug == "not-finite"
    assert "view 04: T_base_flange" in str(error)


def test_nan_among_pixels_names_the_view():
    pixels = GOOD.observations.views[5].pixels.copy()
    pixels[7, 1] = np.inf
    error = refused(with_view(5, pixels=pixels))
    assert error.slug == "not-finite"
    assert "view 06" in str(error)


def test_a_mirrored_pose_is_not_rigid():
    error = refused(with_view(2, T_base_flange=GOOD.T_base_flange[2] @ np.diag([1.0, 1.0, -1.0, 1.0])))
    assert error.slug == "not-rigid"
    assert "view 03" in str(error)
    assert "mirrored" in str(error)


def test_a_scaled_pose_is_not_rigid():
    assert (
        refused(with_view(2, T_base_flange=GOOD.T_base_flange[2] @ np.diag([2.0, 2.0, 2.0, 1.0]))).slug == "not-rigid"
    )


def test_flange_poses_in_millimetres_are_rejected():
    T = GOOD.T_base_flange
    T[:, :3, 3] *= 1000
    error = refused(with_poses(GOOD.observations, T))
    assert error.slug == "millimetres"
    assert "give metres" in str(error)


def test_seven_views_are_too_few():
    error = refused(replace(GOOD.observations, views=GOOD.observations.views[:7]))
    assert error.slug == "too-few-views"
    assert "7 views" in str(error)


def test_views_with_few_corners_do_not_count():
    views = tuple(
        replace(view, ids=view.ids[:5], pixels=view.pixels[:5]) if k < 5 else view
        for k, view in enumerate(GOOD.observations.views)
    )
    assert refused(replace(GOOD.observations, views=views)).slug == "too-few-corners"
    check_observations(replace(GOOD.observations, views=views[1:] + GOOD.observations.views[:1]))


def test_corners_in_one_row_are_not_enough():
    row = BOARD.columns - 1
    assert not enough_corners(np.arange(row), BOARD)
    assert enough_corners(np.arange(row + 1), BOARD)
    assert not enough_corners(np.array([0, 1, 2, row, row + 1]), BOARD)  # not on a line, but only five


def test_too_few_different_poses_are_rejected():
    T = np.repeat(GOOD.T_base_flange[:4], 3, axis=0)
    error = refused(with_poses(GOOD.observations, T))
    assert error.slug == "duplicate-views"
    assert "4 different poses for 12 views" in str(error)


def test_a_repeated_pose_is_accepted():
    T = GOOD.T_base_flange
    T[1] = T[0]
    check_observations(with_poses(GOOD.observations, T))


def test_pure_translation_is_rejected():
    T = turned(GOOD.T_base_flange, Rotation.from_rotvec(np.random.default_rng(0).normal(0, np.radians(2), (12, 3))))
    error = refused(with_poses(GOOD.observations, T))
    assert error.slug == "pure-translation"
    assert "15 are needed: add views" in str(error)


@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [0.3, -0.8, 0.5]])
def test_parallel_axes_are_rejected(axis):
    rng = np.random.default_rng(0)
    angles = np.linspace(-2.5, 2.5, 12)[:, None] * (np.array(axis) / np.linalg.norm(axis))
    wobble = Rotation.from_rotvec(rng.normal(0, np.radians(1), (12, 3)))
    T = turned(GOOD.T_base_flange, Rotation.from_rotvec([1.0, 2.0, 0.0]) * Rotation.from_rotvec(angles) * wobble)
    assert refused(with_poses(GOOD.observations, T)).slug == "parallel-axes"


def test_the_rotation_spread_of_known_rotations():
    # About z by +-20 degrees and about x by +-6: rms 20 / sqrt(2) and 6 / sqrt(2).
    turns = np.radians([[0, 0, 20], [0, 0, -20], [6, 0, 0], [-6, 0, 0]])
    spread = motion_diversity(np.array([from_rotation_vector([0, 0, 0], turn) for turn in turns]))
    assert np.degrees(spread.max_rotation_rad) == pytest.approx(40, abs=1e-9)
    # Rotations do not add exactly, and the sample deviation of four is larger by sqrt(4 / 3).
    assert np.degrees(spread.second_axis_rad) == pytest.approx(6 / np.sqrt(2) * np.sqrt(4 / 3), rel=0.02)


@pytest.mark.parametrize(
    ("K", "why"),
    [
        (np.diag([0.0, 800.0, 1.0]), "focal lengths"),
        (np.array([[800.0, 0, 5000], [0, 800, 400], [0, 0, 1]]), "optical axis"),
        (np.array([[1600.0, 0, 1279], [0, 1600, 799], [0, 0, 1]]), "not near the middle of 1280 x 800"),
        (np.array([[800.0, 0, 640], [0, 800, 400], [0, 0, 2]]), "does not have the form"),
        (np.array([[800.0, 0, 0], [0, 800, 0], [640, 400, 1]]), "does not have the form"),
        (np.eye(4), "shape"),
    ],
)
def test_an_impossible_camera_matrix_is_rejected(K, why):
    error = refused(replace(GOOD.observations, K=K))
    assert error.slug == "intrinsics"
    assert why in str(error)


def test_nan_in_the_camera_matrix_is_rejected():
    assert refused(replace(GOOD.observations, K=GOOD.K * np.nan)).slug == "not-finite"


def test_a_distortion_of_another_model_is_rejected():
    assert refused(replace(GOOD.observations, distortion=np.zeros(3))).slug == "intrinsics"


def test_pixels_outside_the_image_are_rejected():
    error = refused(replace(GOOD.observations, image_size=(800, 500), K=GOOD.K * [[0.7], [0.7], [1]]))
    assert error.slug == "outside-image"
    assert "800 x 500" in str(error)


def test_corners_that_do_not_belong_to_the_board_are_rejected():
    view = GOOD.observations.views[4]
    assert refused(with_view(4, ids=view.ids + 30)).slug == "corners"
    assert refused(with_view(4, ids=np.zeros_like(view.ids))).slug == "corners"
    assert refused(with_view(4, ids=view.ids[:-1])).slug == "corners"


def test_two_views_with_the_same_name_are_rejected():
    assert refused(with_view(4, name="01")).slug == "repeated-names"


def test_a_rotation_vector_is_in_radians():
    T = pose_from_vector([0.1, 0.2, 0.3], [np.pi, 0.0, 0.0])
    np.testing.assert_allclose(T, [[1, 0, 0, 0.1], [0, -1, 0, 0.2], [0, 0, -1, 0.3], [0, 0, 0, 1]], atol=1e-12)


@pytest.mark.parametrize(
    ("xyz_m", "rotvec", "slug"),
    [
        ([0.1, 0.2, 0.3], [178.0, 3.0, -12.0], "degrees"),
        ([0.1, 0.2, 0.3], [0.0, 6.4, 0.0], "degrees"),
        ([100.0, 200.0, 300.0], [3.1, 0.0, 0.0], "millimetres"),
        ([0.1, np.nan, 0.3], [3.1, 0.0, 0.0], "not-finite"),
        ([0.1, 0.2], [3.1, 0.0, 0.0], "not-rigid"),
        ([0.1, 0.2, 0.3], ["a", 0, 0], "not-rigid"),
    ],
)
def test_an_impossible_pose_vector_is_rejected(xyz_m, rotvec, slug):
    with pytest.raises(HandEyeInputError, match="view 7") as caught:
        pose_from_vector(xyz_m, rotvec, "view 7")
    assert caught.value.slug == slug


def test_observations_without_views_are_rejected():
    assert refused(replace(GOOD.observations, views=())).slug == "too-few-views"


def test_a_skewed_camera_matrix_is_named():
    K = GOOD.observations.K.copy()
    K[0, 1] = 4.0
    error = refused(replace(GOOD.observations, K=K))
    assert error.slug == "intrinsics"
    assert "skew of 4" in str(error)
    K[:2, :2] = [[800.0, 1e-12], [0.0, 800.0]]
    check_observations(replace(GOOD.observations, K=K))


def test_a_transposed_camera_matrix_is_named():
    error = refused(replace(GOOD.observations, K=GOOD.observations.K.T.copy()))
    assert error.slug == "intrinsics"
    assert "row by row" in str(error)


def test_a_camera_that_does_not_move_with_the_robot_is_named():
    nearly_alike = GOOD.T_camera_board[:1] @ pose_from_twist(np.random.default_rng(0).normal(0, 3e-4, (12, 6)))
    for boards in (np.repeat(GOOD.T_camera_board[:1], 12, axis=0), nearly_alike):
        with pytest.raises(HandEyeInputError, match="board rotates by 0") as caught:
            check_camera_moved(boards)
        assert caught.value.slug == "camera-did-not-move"


def test_an_unknown_mounting_is_rejected():
    mounting: Any = "on the wall"
    error = refused(replace(GOOD.observations, mounting=mounting))
    assert error.slug == "mounting"
    assert "'eye-in-hand' or 'eye-to-hand'" in str(error)
