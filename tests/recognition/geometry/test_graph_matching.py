"""The best couples of ends, against trying all of them."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import recognition.geometry.graph_matching
from recognition.geometry.graph_matching import matching_margins, maximum_weight_matching

Ends = NDArray[np.int64]
ENDS = 6
ALL = list(combinations(range(ENDS), 2))
graphs = st.lists(st.tuples(st.sampled_from(ALL), st.integers(-3, 9)), max_size=9, unique_by=lambda couple: couple[0])


def most(couples: list[tuple[tuple[int, int], int]]) -> int:
    """The largest gain of any set of couples that share no end."""
    if not couples:
        return 0
    (ends, gain), rest = couples[0], couples[1:]
    return max(most(rest), gain + most([other for other in rest if not set(ends) & set(other[0])]))


def arrays(couples: list[tuple[tuple[int, int], int]]) -> tuple[Ends, Ends, NDArray[np.float64]]:
    a, b = np.array([ends for ends, _ in couples], dtype=np.int64).reshape(-1, 2).T
    return a, b, np.array([gain for _, gain in couples], dtype=np.float64)


@given(graphs)
def test_no_other_couples_gain_more(couples: list[tuple[tuple[int, int], int]]) -> None:
    a, b, gain = arrays(couples)
    taken = maximum_weight_matching(a, b, gain)
    ends = [*a[taken], *b[taken]]
    assert len(ends) == len(set(ends))
    assert gain[taken].sum() == most(couples)
    for couple, margin in zip(taken, matching_margins(taken, a, b, gain), strict=True):
        assert margin == most(couples) - most([*couples[:couple], *couples[couple + 1 :]])


def test_of_couples_equally_good_the_same_are_taken_each_time() -> None:
    # Two answers gain 3. Releases of rustworkx before 0.18 give now this one and now that.
    couples = arrays([((0, 2), 2), ((0, 4), 1), ((1, 4), 1), ((2, 4), 2), ((3, 4), 1)])
    answers = {tuple(maximum_weight_matching(*couples)) for _ in range(50)}
    assert len(answers) == 1


def test_where_too_many_compete_no_couple_is_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recognition.geometry.graph_matching, "MOST_RIVALS", 2)
    a, b, gain = arrays([((0, 1), 2), ((2, 3), 5), ((3, 4), 3)])
    assert matching_margins(maximum_weight_matching(a, b, gain), a, b, gain).tolist() == [2.0, 0.0]


def test_a_thousand_ends_are_matched() -> None:
    # Far more than real scenes have: a search that grew with the number of sets would not end.
    rng = np.random.default_rng(1)
    a, b = np.unique(np.sort(rng.integers(0, 1000, (5000, 2)), axis=1), axis=0).T
    a, b = a[a != b], b[a != b]
    taken = maximum_weight_matching(a, b, rng.uniform(0.5, 1.0, len(a)))
    assert len(set(a[taken]) | set(b[taken])) == 2 * len(taken) > 900
