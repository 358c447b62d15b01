"""Board poses, each estimated from its own image."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.projection import stack_corners
from tests.calibration.board_views import NOISE_FREE, record


def test_exact_corners_give_the_exact_pose() -> None:
    recorded = record(1, 12, NOISE_FREE)
    found = estimate_board_poses(stack_corners(recorded.observations))
    np.testing.assert_allclose(found.T_camera_board, recorded.T_camera_board, atol=1e-10)
    assert found.rms_px.max() < 1e-9


def test_noise_appears_as_reprojection_error() -> None:
    found = estimate_board_poses(stack_corners(record(2, 20).observations))
    # 0.2 px, slightly reduced by the six parameters of a pose. 20 views of 140 coordinates scatter by 1.4 %.
    assert np.sqrt(np.mean(found.rms_px**2)) == pytest.approx(0.2 * np.sqrt(1 - 6 / 140), rel=0.05)


def test_a_misplaced_corner_is_excluded() -> None:
    recorded = record(3, 8, NOISE_FREE)
    views = list(recorded.observations.views)
    pixels = views[2].pixels.copy()
    pixels[10] += (15.0, -9.0)
    views[2] = replace(views[2], pixels=pixels)
    found = estimate_board_poses(stack_corners(replace(recorded.observations, views=tuple(views))))
    np.testing.assert_allclose(found.T_camera_board[2], recorded.T_camera_board[2], atol=1e-10)
    assert list(np.flatnonzero(~found.inliers[2])) == [views[2].ids[10]]


def test_corners_on_a_line_or_too_few_give_no_pose() -> None:
    recorded = record(4, 8)
    views = list(recorded.observations.views)
    board = recorded.observations.board
    row = views[0].ids < board.columns - 1
    views[0] = replace(views[0], ids=views[0].ids[row], pixels=views[0].pixels[row])
    views[1] = replace(views[1], ids=views[1].ids[:5], pixels=views[1].pixels[:5])
    found = estimate_board_poses(stack_corners(replace(recorded.observations, views=tuple(views))))
    assert list(np.flatnonzero(~found.found)) == [0, 1]
    assert np.isnan(found.T_camera_board[:2]).all()


def test_corners_of_another_board_give_no_pose() -> None:
    recorded = record(5, 8)
    views = list(recorded.observations.views)
    views[3] = replace(views[3], pixels=np.random.default_rng(0).uniform(100, 700, views[3].pixels.shape))
    found = estimate_board_poses(stack_corners(replace(recorded.observations, views=tuple(views))))
    # Either no pose fits, or the best one fits much worse than the noise of a corner.
    assert not found.found[3] or found.rms_px[3] > 20.0
