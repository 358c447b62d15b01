"""Views of boards that look alike from several sides, numbered from any of them, come out numbered alike."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.board import Board
from calibration.grid_numbering import renumberings
from calibration.number_alike import number_alike
from calibration.observations import Mounting, Observations
from tests.calibration.board_views import record

DOTS = Board(kind="circles", columns=7, rows=7, pitch_m=0.02)
SQUARES = Board(kind="checkerboard", columns=9, rows=7, pitch_m=0.02)


def numbered_anyhow(observations: Observations, seed: int) -> tuple[Observations, np.ndarray]:
    """Each view numbered from any side that the board allows, and from which."""
    possible = renumberings(observations.board)
    chosen = np.random.default_rng(seed).integers(0, len(possible), len(observations.views))
    views = (
        replace(view, ids=possible[choice][view.ids]) for view, choice in zip(observations.views, chosen, strict=True)
    )
    return replace(observations, views=tuple(views)), chosen


@pytest.mark.parametrize("mounting", ["eye-in-hand", "eye-to-hand"])
@pytest.mark.parametrize("board", [DOTS, SQUARES])
def test_all_are_numbered_alike(board: Board, mounting: Mounting) -> None:
    for seed in range(5):
        given = record(seed, 12, board=board, mounting=mounting).observations
        shuffled, _ = numbered_anyhow(given, seed)
        got = number_alike(shuffled, [False] * 12)
        # Any of the board's numberings will do, the same in all.
        fitting = [
            numbers
            for numbers in renumberings(board)
            if all((numbers[a.ids] == b.ids).all() for a, b in zip(given.views, got.views, strict=True))
        ]
        assert len(fitting) == 1


def test_views_that_are_certain_decide() -> None:
    given = record(3, 12, board=DOTS).observations
    shuffled, chosen = numbered_anyhow(given, 3)
    got = number_alike(shuffled, list(chosen == 0))
    assert 0 < (chosen == 0).sum() < 12
    for a, b in zip(given.views, got.views, strict=True):
        np.testing.assert_array_equal(a.ids, b.ids)


def test_a_stale_pose_spoils_no_other_view() -> None:
    given = record(4, 12, board=DOTS).observations
    shuffled, _ = numbered_anyhow(given, 4)
    views = list(shuffled.views)
    views[5] = replace(views[5], T_base_flange=views[4].T_base_flange)
    got = number_alike(replace(shuffled, views=tuple(views)), [False] * 12)
    fitting = [
        numbers
        for numbers in renumberings(DOTS)
        if all((numbers[given.views[k].ids] == got.views[k].ids).all() for k in range(12) if k != 5)
    ]
    assert len(fitting) == 1


def test_a_board_with_a_first_corner_is_left_alone() -> None:
    given = record(1, 10).observations
    assert number_alike(given, [False] * 10) is given
