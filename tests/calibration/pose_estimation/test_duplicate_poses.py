"""Views from one robot pose share its error, so one of them counts and the others are named."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import HandEyeInputError
from calibration.geometry.transforms import from_rotation_vector
from calibration.hand_eye import solve_hand_eye
from calibration.observations import BoardView, Observations
from calibration.pose_estimation.duplicate_poses import group_equal_poses
from tests.calibration.board_views import Noise, realistic_plan, record, squared_error_in_sigmas

pytestmark = pytest.mark.slow

WORN = Noise(robot_m=3e-4, robot_rad=float(np.radians(0.06)))
"""Noise of a robot with three times the usual error, so that its error dominates."""


def repeated(observations: Observations, times: int, seed: int = 0) -> Observations:
    """Repeat each view `times` times.

    The corners are detected again, and the pose is read again from a robot at rest, with errors of some hundredths of a
    millimetre and thousandths of a degree.
    """
    rng = np.random.default_rng(seed)

    def again(view: BoardView, k: int) -> BoardView:
        read = from_rotation_vector(rng.normal(0, 2e-5, 3), rng.normal(0, np.radians(0.003), 3))
        pixels = view.pixels + rng.normal(0, 0.2, view.pixels.shape)
        return replace(view, name=f"{view.name}_{k}", T_base_flange=view.T_base_flange @ read, pixels=pixels)

    views = (view if k == 0 else again(view, k) for view in observations.views for k in range(times))
    return replace(observations, views=tuple(views))


def test_equal_poses_are_grouped() -> None:
    pose = from_rotation_vector((0.4, 0.1, 0.5), (2.2, -2.0, 0.3))
    moves = [
        ((0.0, 0.0, 0.0), 0.0),
        ((5e-4, 0.0, 0.0), 0.1),
        ((2e-3, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0), 0.5),
        ((0.0, 0.0, 3e-4), 0.0),
        ((2e-3, 0.0, 1e-4), 0.0),
    ]
    poses = np.array([pose @ from_rotation_vector(off_m, (0.0, np.radians(turn), 0.0)) for off_m, turn in moves])
    assert group_equal_poses(poses).tolist() == [0, 0, 2, 3, 0, 2]


def test_views_from_one_pose_do_not_reduce_the_covariance() -> None:
    squares = []
    for seed in range(10):
        recorded = record(seed, 10, WORN, realistic_plan)
        once, often = (solve_hand_eye(repeated(recorded.observations, times, seed)) for times in (1, 4))
        np.testing.assert_array_equal(often.X, once.X)
        np.testing.assert_array_equal(often.covariance, once.covariance)
        assert often.findings == once.findings
        squares.append(squared_error_in_sigmas(often, recorded.X))
    # The mean of ten errors with six components is 6 +- 1.1. With duplicates counted as independent it is about 25.
    assert np.mean(squares) < 12.0


def test_duplicates_are_named() -> None:
    observations = record(2, 10, WORN, realistic_plan).observations
    views = repeated(observations, 2).views
    views = (replace(views[0], ids=views[0].ids[:40], pixels=views[0].pixels[:40]), *views[1:])
    result = solve_hand_eye(replace(observations, views=views))
    assert [view.name for view in result.views] == [view.name for view in views]
    # The view with more corners is used.
    assert [view.name for view in result.views if not view.used] == ["01", *(f"{k:02d}_1" for k in range(2, 11))]
    assert "the robot pose is the same as in view 01_1" in (result.views[0].reason or "")
    assert "the robot pose is the same as in view 02" in (result.views[3].reason or "")
    assert (result.views[0].corners, result.views[0].loo_error_m) == (40, None)


def test_many_views_from_one_pose_do_not_outvote_the_others() -> None:
    recorded = record(3, 12, plan=realistic_plan)
    views = recorded.observations.views
    crowd = repeated(replace(recorded.observations, views=views[:1]), 40).views
    result = solve_hand_eye(replace(recorded.observations, views=(*crowd, *views[1:])))
    np.testing.assert_array_equal(result.X, solve_hand_eye(recorded.observations).X)


def test_the_required_number_counts_different_poses() -> None:
    observations = record(4, 7, plan=realistic_plan).observations
    with pytest.raises(HandEyeInputError, match="7 different poses for 28 views"):
        solve_hand_eye(repeated(observations, 4))
