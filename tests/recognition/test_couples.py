"""The best couples of ends, against trying all of them."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import recognition.couples
from recognition.couples import best_couples
from recognition.errors import TooCrowdedError

ENDS = 6
ALL = list(combinations(range(ENDS), 2))
graphs = st.lists(st.tuples(st.sampled_from(ALL), st.integers(-3, 9)), max_size=9, unique_by=lambda couple: couple[0])


def most(couples: list[tuple[tuple[int, int], int]]) -> int:
    """The largest gain of any set of couples that share no end."""
    if not couples:
        return 0
    (ends, gain), rest = couples[0], couples[1:]
    return max(most(rest), gain + most([other for other in rest if not set(ends) & set(other[0])]))


def found(couples: list[tuple[tuple[int, int], int]]) -> tuple[list[tuple[int, int]], list[float]]:
    a, b = np.array([ends for ends, _ in couples], dtype=np.int64).reshape(-1, 2).T
    return best_couples(ENDS, a, b, np.array([gain for _, gain in couples], dtype=np.float64))


@given(graphs)
def test_no_other_couples_gain_more(couples: list[tuple[tuple[int, int], int]]) -> None:
    taken, margins = found(couples)
    ends = [end for couple in taken for end in couple]
    assert len(ends) == len(set(ends))
    gains = dict(couples)
    assert sum(gains[couple] for couple in taken) == most(couples)
    for couple, margin in zip(taken, margins, strict=True):
        assert margin == pytest.approx(most(couples) - most([other for other in couples if other[0] != couple]))


def test_when_time_is_out_nothing_is_guessed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recognition.couples, "SOLVE_S", 0.0)
    with pytest.raises(TooCrowdedError, match="cannot be found within 0 s: check the string's radius"):
        found([((0, 1), 2), ((1, 2), 3)])
    # What needs no search is found all the same.
    assert found([((0, 1), 2), ((2, 3), 3)]) == ([(0, 1), (2, 3)], [2.0, 3.0])
