"""An end with string ahead of it that is in no chain was not seen to stop."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.missed_ends import mark_unobserved_ends
from recognition.model.model import Chain
from recognition.parameters import ChainParameters

R = 0.0042


def line(start_mm: tuple[float, float], end_mm: tuple[float, float]) -> np.ndarray:
    """Points 1 mm apart at the height of a string on the table."""
    a, b = np.array([*start_mm, 4.2]) / 1000, np.array([*end_mm, 4.2]) / 1000
    return np.linspace(a, b, round(np.linalg.norm(b - a) * 1000) + 1)


def chain(points: np.ndarray, closed: bool = False) -> Chain:
    count = len(points)
    return Chain(0, closed, R, points, np.zeros(count), np.ones(count, dtype=np.int64), ("free", "free"))


ALONG_X = chain(line((0, 0), (100, 0)))
# What is left over begins 2 r = 8.4 mm from the chain.
AHEAD = line((109, 0), (125, 0))


def test_an_end_with_a_piece_in_line_is_unseen(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([ALONG_X], [AHEAD], table_1)
    assert found.ends == ("free", "unseen")
    (found,) = mark_unobserved_ends([replace(ALONG_X, points=ALONG_X.points[::-1])], [AHEAD], table_1)
    assert found.ends == ("unseen", "free")


def test_a_string_that_bends_away_is_in_line(table_1: ChainParameters) -> None:
    # An arc of radius 20 mm, farther than 8.4 mm from the chain's end.
    turn = np.radians(np.arange(26, 60, 2))
    bent = np.column_stack([0.1 + 0.02 * np.sin(turn), 0.02 * (1 - np.cos(turn)), np.full(len(turn), R)])
    (found,) = mark_unobserved_ends([ALONG_X], [bent], table_1)
    assert found.ends == ("free", "unseen")


@pytest.mark.parametrize(
    "elsewhere", [line((114, 0), (130, 0)), line((100, 9), (100, 30)), line((90, 9), (106, 12)), line((20, 9), (60, 9))]
)
def test_what_is_far_or_aside_is_another_thing(table_1: ChainParameters, elsewhere: np.ndarray) -> None:
    (found,) = mark_unobserved_ends([ALONG_X], [elsewhere], table_1)
    assert found.ends == ("free", "free")


def test_from_a_thicker_chain_it_may_be_farther(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([replace(ALONG_X, radius_m=0.006)], [line((113, 0), (130, 0))], table_1)
    assert found.ends == ("free", "unseen")


def test_what_was_unseen_stays_so_and_a_ring_has_no_end(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([replace(ALONG_X, ends=("unseen", "free"))], [AHEAD], table_1)
    assert found.ends == ("unseen", "unseen")
    ring = replace(ALONG_X, closed=True)
    assert mark_unobserved_ends([ring], [AHEAD], table_1) == (ring,)


def test_nothing_left_over_or_no_chains(table_1: ChainParameters) -> None:
    assert mark_unobserved_ends([ALONG_X], [], table_1) == (ALONG_X,)
    assert mark_unobserved_ends([], [AHEAD], table_1) == ()


def test_a_chain_of_two_points_has_a_direction(table_1: ChainParameters) -> None:
    (found,) = mark_unobserved_ends([chain(line((99, 0), (100, 0)))], [AHEAD], table_1)
    assert found.ends == ("free", "unseen")
