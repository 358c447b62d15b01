"""The whole solver: exact views, wrong views by name, and what the result reports."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import HandEyeInputError
from calibration.hand_eye import solve_hand_eye
from calibration.observations import Mounting, Observations
from calibration.solver.noise import NoisePriors
from tests.calibration.board_views import (
    NOISE_FREE,
    Noise,
    Recorded,
    error_of,
    orbit_plan,
    realistic_plan,
    record,
    with_poses,
    with_swapped_pictures,
    with_turned_board,
)

pytestmark = pytest.mark.slow

MOUNTINGS: list[Mounting] = ["eye-in-hand", "eye-to-hand"]
WRONG = ["swapped", "stale", "off by 10 mm", "turned"]


def spoilt(recorded: Recorded, how: str) -> tuple[Observations, dict[str, str]]:
    """Return views with a mistake, and the expected part of the reason by the name of each wrong view."""
    observations, poses = recorded.observations, recorded.T_base_flange
    match how:
        case "swapped":
            wrong = {"04": "fits the pose of view 09", "09": "fits the pose of view 04"}
            return with_swapped_pictures(observations, 3, 8), wrong
        case "stale":
            poses[6] = poses[5]
            return with_poses(observations, poses), {"07": "its pose is that of view 06"}
        case "off by 10 mm":
            poses[6, :3, 3] += (0.0, 0.01, 0.0)
            return with_poses(observations, poses), {"07": "mm and"}
        case _:
            return with_turned_board(observations, 2), {"03": "half a turn"}


def check_named(seeds: range, how: str, mounting: Mounting) -> None:
    for seed in seeds:
        recorded = record(seed, 15, plan=realistic_plan, mounting=mounting)
        observations, wrong = spoilt(recorded, how)
        result = solve_hand_eye(observations)
        reasons = {view.name: view.reason or "" for view in result.views if not view.used}
        assert reasons.keys() == wrong.keys()
        assert all(part in reasons[name] for name, part in wrong.items())
        assert result.verdict == "accept"
        degrees, millimetres = error_of(result.X, recorded.X)
        assert degrees < 0.12
        assert millimetres < 0.9


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_exact_views_give_the_exact_camera(mounting: Mounting) -> None:
    for seed in range(3):
        recorded = record(seed, 12, NOISE_FREE, plan=realistic_plan, mounting=mounting)
        result = solve_hand_eye(recorded.observations)
        degrees, millimetres = error_of(result.X, recorded.X)
        assert degrees < 1e-6
        assert millimetres < 1e-6
        np.testing.assert_allclose(result.Y, recorded.Y, atol=1e-9)
        np.testing.assert_allclose(result.K, recorded.K, atol=1e-6)
        assert result.verdict == "accept"


@pytest.mark.parametrize("mounting", MOUNTINGS)
@pytest.mark.parametrize("how", WRONG)
def test_wrong_views_are_named_and_excluded(how: str, mounting: Mounting) -> None:
    check_named(range(3), how, mounting)


@pytest.mark.soak
@pytest.mark.parametrize("how", WRONG)
def test_wrong_views_are_named_30_times_of_30(how: str) -> None:
    check_named(range(30), how, "eye-in-hand")


def test_a_slightly_wrong_view_is_detected() -> None:
    # One millimetre among errors of 0.1 mm and 0.02 degrees (0.15 mm at the board).
    recorded = record(4, 15, plan=realistic_plan)
    poses = recorded.T_base_flange
    poses[9, :3, 3] += (0.0, 0.0, 0.0012)
    result = solve_hand_eye(with_poses(recorded.observations, poses))
    assert [view.name for view in result.views if not view.used] == ["10"]


def test_the_board_size_is_estimated() -> None:
    for seed in range(4):
        result = solve_hand_eye(record(seed, 15, Noise(scale=0.01), plan=realistic_plan).observations)
        # The prior of 0.2 % pulls it towards the given size by (sigma / prior)^2, about 15 %, at most 0.2 %.
        assert result.board_scale - 1 == pytest.approx(0.01, abs=0.002 + 3 * result.board_scale_sigma)
        assert result.verdict == "refuse"
        assert any(finding.code == "board-scale" for finding in result.findings)


def test_the_board_size_is_undetermined_from_one_distance() -> None:
    result = solve_hand_eye(record(0, 15, plan=orbit_plan).observations)
    assert result.board_scale_sigma > 0.0015
    # The reported covariance and the predicted repeatability include it.
    assert result.sigma_m > 0.0015
    assert result.repeatability_95_m > 2 * result.sigma_m
    assert [finding.code for finding in result.findings] == ["board-scale-unverified"]


def test_distorted_images_are_undistorted() -> None:
    import cv2

    recorded = record(5, 12, NOISE_FREE)
    observations = recorded.observations
    distortion = np.array([-0.3, 0.1, 4e-4, -3e-4, 0.0])
    views = []
    for view in observations.views:
        rays = np.column_stack(
            [(view.pixels - observations.K[:2, 2]) / observations.K[[0, 1], [0, 1]], np.ones(len(view.pixels))]
        )
        pixels = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), observations.K, distortion)[0]
        views.append(replace(view, pixels=pixels.reshape(-1, 2).astype(np.float64)))
    result = solve_hand_eye(replace(observations, views=tuple(views), distortion=distortion))
    degrees, millimetres = error_of(result.X, recorded.X)
    # The images and their undistortion are exact.
    assert degrees < 1e-5
    assert millimetres < 1e-4


def test_the_result_reports_every_view() -> None:
    recorded = record(6, 15, plan=realistic_plan)
    observations, _ = spoilt(recorded, "off by 10 mm")
    result = solve_hand_eye(observations)
    assert [view.name for view in result.views] == [view.name for view in observations.views]
    wrong = result.views[6]
    assert wrong.robot_error_m == pytest.approx(0.01, abs=0.001)
    assert wrong.loo_error_m == pytest.approx(0.01, abs=0.001)
    for view in result.views:
        assert view.corners == 70
        # 140 coordinates with noise of 0.2 px.
        assert view.rms_px == pytest.approx(0.2, rel=0.35)
        assert view.distance_m == pytest.approx(0.4, abs=0.08)
        if view.used:
            assert view.robot_error_m is not None
            assert view.robot_error_m < 5e-4
    # The middle of the board with robot errors of 0.1 mm and 0.02 degrees at 0.45 m, and the error of the image.
    assert 1e-4 < result.loo_error_m < 6e-4
    assert result.repeatability_95_m < 2e-3
    assert result.robot_sigma_m < 3e-4


def test_views_without_the_board_are_named() -> None:
    recorded = record(7, 12)
    views = list(recorded.observations.views)
    views[4] = replace(views[4], ids=views[4].ids[:3], pixels=views[4].pixels[:3])
    result = solve_hand_eye(replace(recorded.observations, views=tuple(views)))
    assert not result.views[4].used
    assert "3 corners" in (result.views[4].reason or "")
    assert result.views[4].rms_px is None
    assert result.verdict == "accept"


def test_views_that_show_too_little_of_the_board_do_not_affect_the_others() -> None:
    recorded = record(7, 12, plan=realistic_plan)
    views = list(recorded.observations.views)
    for k in (1, 4, 7, 10):
        views[k] = replace(views[k], ids=views[k].ids[:5], pixels=views[k].pixels[:5])
    result = solve_hand_eye(replace(recorded.observations, views=tuple(views)))
    assert sum(view.used for view in result.views) == 8
    assert result.verdict == "accept"


def test_a_view_without_corners_of_a_distorting_camera_is_named() -> None:
    recorded = record(7, 12, plan=realistic_plan)
    views = list(recorded.observations.views)
    views[4] = replace(views[4], ids=views[4].ids[:0], pixels=views[4].pixels[:0])
    distortion = np.array([1e-4, 0.0, 0.0, 0.0, 0.0])
    result = solve_hand_eye(replace(recorded.observations, views=tuple(views), distortion=distortion))
    assert [view.name for view in result.views if not view.used] == ["05"]
    assert result.verdict == "accept"


def test_the_same_image_at_all_poses_is_refused() -> None:
    observations = record(9, 12, plan=realistic_plan).observations
    first = observations.views[0]
    views = tuple(replace(view, ids=first.ids, pixels=first.pixels) for view in observations.views)
    with pytest.raises(HandEyeInputError) as caught:
        solve_hand_eye(replace(observations, views=views))
    assert caught.value.slug == "camera-did-not-move"


@pytest.mark.parametrize("name", ["pixel_px", "robot_m", "robot_rad", "focal", "centre", "scale"])
@pytest.mark.parametrize("value", [0.0, -0.001, float("nan"), float("inf")])
def test_invalid_noise_priors_are_rejected(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} is .*small one"):
        replace(NoisePriors(), **{name: value})


def test_nearly_exact_noise_priors_fix_the_board_size() -> None:
    recorded = record(1, 12, plan=realistic_plan)
    result = solve_hand_eye(recorded.observations, NoisePriors(focal=1e-9, centre=1e-9, scale=1e-9))
    assert result.verdict == "accept"
    assert result.board_scale == pytest.approx(1.0, abs=1e-6)


def test_random_corners_are_refused_with_a_message() -> None:
    recorded = record(8, 10)
    rng = np.random.default_rng(0)
    views = tuple(replace(view, pixels=rng.uniform(20, 700, view.pixels.shape)) for view in recorded.observations.views)
    with pytest.raises(HandEyeInputError, match=r"view|corner"):
        solve_hand_eye(replace(recorded.observations, views=views))
