"""Views of symmetric boards that are numbered from any corner get a consistent numbering."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.dataset.setup import Setup
from calibration.dataset.view_detection import make_views_consistent
from calibration.geometry.transforms import from_rotation_vector
from calibration.observations import Mounting, Observations
from calibration.pose_estimation.corner_disambiguation import make_numbering_consistent, renumber_to_prediction
from calibration.target.board import Board
from calibration.target.corner_ordering import symmetric_numberings
from tests.calibration.board_views import record

DOTS = Board(kind="circles", columns=7, rows=7, pitch_m=0.02)
SQUARES = Board(kind="checkerboard", columns=9, rows=7, pitch_m=0.02)


def randomly_numbered(observations: Observations, seed: int) -> tuple[Observations, np.ndarray]:
    """Return views with random numberings that the board allows, and the chosen numberings."""
    possible = symmetric_numberings(observations.board)
    chosen = np.random.default_rng(seed).integers(0, len(possible), len(observations.views))
    views = (
        replace(view, ids=possible[choice][view.ids]) for view, choice in zip(observations.views, chosen, strict=True)
    )
    return replace(observations, views=tuple(views)), chosen


@pytest.mark.parametrize("mounting", ["eye-in-hand", "eye-to-hand"])
@pytest.mark.parametrize("board", [DOTS, SQUARES])
def test_all_views_get_the_same_numbering(board: Board, mounting: Mounting) -> None:
    for seed in range(5):
        given = record(seed, 12, board=board, mounting=mounting).observations
        shuffled, _ = randomly_numbered(given, seed)
        got = make_numbering_consistent(shuffled, [False] * 12)
        # Any numbering of the board is correct if it is the same in all views.
        fitting = [
            numbers
            for numbers in symmetric_numberings(board)
            if all((numbers[a.ids] == b.ids).all() for a, b in zip(given.views, got.views, strict=True))
        ]
        assert len(fitting) == 1


@pytest.mark.parametrize("board", [DOTS, SQUARES])
def test_held_out_views_get_the_same_numbering(board: Board) -> None:
    given = record(6, 14, board=board).observations
    shuffled, _ = randomly_numbered(given, 6)
    setup = Setup.from_observations(given)
    solved_from, held_out = make_views_consistent(setup, shuffled.views, [False] * 14, {"03", "14"})
    assert [view.name for view in held_out.views] == ["03", "14"]
    got = {view.name: view for view in (*solved_from.views, *held_out.views)}
    assert len(got) == 14
    fitting = [
        numbers
        for numbers in symmetric_numberings(board)
        if all((numbers[view.ids] == got[view.name].ids).all() for view in given.views)
    ]
    assert len(fitting) == 1


@pytest.mark.parametrize("board", [DOTS, SQUARES])
def test_numbering_follows_the_predicted_pose(board: Board) -> None:
    recorded = record(7, 8, board=board)
    shuffled, chosen = randomly_numbered(recorded.observations, 8)
    assert len(set(chosen)) > 1
    # The prediction is off by 20 degrees, less than half of the least rotation between two numberings.
    off = from_rotation_vector((0.01, 0, 0), np.radians((0, 0, 20)))
    got = renumber_to_prediction(shuffled, recorded.T_camera_board @ off)
    for a, b in zip(recorded.observations.views, got.views, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)


def test_views_with_a_unique_numbering_determine_the_others() -> None:
    given = record(3, 12, board=DOTS).observations
    shuffled, chosen = randomly_numbered(given, 3)
    got = make_numbering_consistent(shuffled, list(chosen == 0))
    assert 0 < (chosen == 0).sum() < 12
    for a, b in zip(given.views, got.views, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)


def test_a_stale_pose_does_not_affect_other_views() -> None:
    given = record(4, 12, board=DOTS).observations
    shuffled, _ = randomly_numbered(given, 4)
    views = list(shuffled.views)
    views[5] = replace(views[5], T_base_flange=views[4].T_base_flange)
    got = make_numbering_consistent(replace(shuffled, views=tuple(views)), [False] * 12)
    fitting = [
        numbers
        for numbers in symmetric_numberings(DOTS)
        if all((numbers[given.views[k].ids] == got.views[k].ids).all() for k in range(12) if k != 5)
    ]
    assert len(fitting) == 1


def test_a_board_without_symmetry_is_unchanged() -> None:
    given = record(1, 10).observations
    assert make_numbering_consistent(given, [False] * 10) is given
