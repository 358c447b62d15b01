"""Quality of a single board image during a calibration."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from calibration.dataset.setup import Setup
from calibration.observations import BoardView
from cell.control.calibration_run import observe_board
from tests.calibration.board_views import NOISE_FREE, record


def only(view: BoardView, pixels: ArrayLike) -> BoardView:
    """Return the view with only its first corners, at other pixels."""
    pixels = np.asarray(pixels, dtype=np.float64)
    return replace(view, ids=view.ids[: len(pixels)], pixels=pixels)


def test_exact_corners_have_no_reprojection_error() -> None:
    observations = record(1, 6, NOISE_FREE).observations
    for view in observations.views:
        seen = observe_board(view, Setup.from_observations(observations))
        assert (seen.corners, seen.board_corners) == (len(view.ids), 70)
        assert seen.rms_px is not None
        assert seen.rms_px < 1e-9


def test_noise_appears_as_reprojection_error() -> None:
    observations = record(2, 20).observations
    errors_px = [
        observe_board(view, Setup.from_observations(observations)).rms_px or np.nan for view in observations.views
    ]
    # 0.2 px, slightly reduced by the six parameters of a pose. 20 views of 140 coordinates scatter by 1.4 %.
    assert np.sqrt(np.mean(np.square(errors_px))) == pytest.approx(0.2 * np.sqrt(1 - 6 / 140), rel=0.05)


def test_the_cells_of_the_image_are_numbered_row_by_row() -> None:
    observations = record(3, 6).observations
    setup, view = Setup.from_observations(observations), observations.views[0]
    assert setup.image_size == (1280, 800)  # cells of 160 x 160
    corners = [(0, 0), (159.9, 10), (1279.4, 0), (170, 0), (0, 799.4), (1279, 799), (640, 400), (-0.4, -0.4)]
    assert observe_board(only(view, corners), setup).cells == (0, 1, 7, 20, 32, 39)


def test_corners_without_a_pose_have_no_reprojection_error() -> None:
    observations = record(4, 6).observations
    view = observations.views[0]
    seen = observe_board(only(view, view.pixels[:5]), Setup.from_observations(observations))
    assert (seen.corners, seen.rms_px) == (5, None)
    assert seen.cells
