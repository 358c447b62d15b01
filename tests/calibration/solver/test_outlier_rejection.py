"""Outlier rejection: a wrong board size is reported and does not exclude views."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.hand_eye import solve_hand_eye
from tests.calibration.board_views import Noise, error_of, realistic_plan, record


@pytest.mark.parametrize("scale", [-0.06, -0.03, -0.015, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_board_size_is_not_reported_as_a_robot_error(scale: float, seed: int) -> None:
    recorded = record(seed, 15, replace(Noise(), scale=scale), plan=realistic_plan)
    result = solve_hand_eye(recorded.observations)
    assert [finding.code for finding in result.findings if finding.blocking] == ["board-scale"]
    assert all(view.used for view in result.views)
    # Four standard deviations, plus the pull of the prior of 0.2 % (if no view is excluded) or 5 % towards 1.
    assert abs(result.board_scale - (1 + scale)) < 4 * result.board_scale_sigma + 0.15 * abs(scale)
    # X has the rest of the error of the size (at most 0.9 % of 6 %) over the 0.35 m to the board, millimetres.
    assert error_of(result.X, recorded.X)[1] < 3.0


def test_views_excluded_for_another_reason_do_not_change_the_scale() -> None:
    recorded = record(1, 15, plan=realistic_plan)
    views = list(recorded.observations.views)
    views[2], views[9] = (
        replace(views[2], T_base_flange=views[9].T_base_flange),
        replace(views[9], T_base_flange=views[2].T_base_flange),
    )
    result = solve_hand_eye(replace(recorded.observations, views=tuple(views)))
    assert sum(view.used for view in result.views) == 13
    assert "board-scale" not in {finding.code for finding in result.findings}
    assert abs(np.log(result.board_scale)) < 0.003
