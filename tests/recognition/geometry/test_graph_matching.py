"""Maximum weight matching of ends, compared with brute force over all sets of pairs."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import recognition.geometry.graph_matching
from recognition.geometry.graph_matching import (
    matching_margins,
    matching_without_conflicts,
    maximum_weight_matching,
)

Ends = NDArray[np.int64]
ENDS = 6
ALL = list(combinations(range(ENDS), 2))
graphs = st.lists(st.tuples(st.sampled_from(ALL), st.integers(-3, 9)), max_size=9, unique_by=lambda pair: pair[0])


def max_gain(pairs: list[tuple[tuple[int, int], int]]) -> int:
    """Return the largest gain of any set of pairs that share no end."""
    if not pairs:
        return 0
    (ends, gain), rest = pairs[0], pairs[1:]
    return max(max_gain(rest), gain + max_gain([other for other in rest if not set(ends) & set(other[0])]))


def arrays(pairs: list[tuple[tuple[int, int], int]]) -> tuple[Ends, Ends, NDArray[np.float64]]:
    a, b = np.array([ends for ends, _ in pairs], dtype=np.int64).reshape(-1, 2).T
    return a, b, np.array([gain for _, gain in pairs], dtype=np.float64)


@given(graphs)
def test_no_other_pairs_gain_more(pairs: list[tuple[tuple[int, int], int]]) -> None:
    a, b, gain = arrays(pairs)
    matched = maximum_weight_matching(a, b, gain)
    ends = [*a[matched], *b[matched]]
    assert len(ends) == len(set(ends))
    assert gain[matched].sum() == max_gain(pairs)
    for pair, margin in zip(matched, matching_margins(matched, a, b, gain), strict=True):
        assert margin == max_gain(pairs) - max_gain([*pairs[:pair], *pairs[pair + 1 :]])


@given(graphs, st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=6))
def test_no_other_pairs_without_conflicts_gain_more(
    pairs: list[tuple[tuple[int, int], int]], opposed: list[tuple[int, int]]
) -> None:
    a, b, gain = arrays(pairs)
    opposed = [(j, k) for j, k in opposed if j < k < len(pairs)]
    conflicts = np.array(opposed, dtype=np.int64).reshape(-1, 2)

    def best(left_out: int = -1) -> float:
        """Return the largest gain of any set of pairs that share no end and have no conflict, without one pair."""
        gains = [0.0]
        for size in range(1, len(pairs) + 1):
            for chosen in combinations(set(range(len(pairs))) - {left_out}, size):
                ends = [end for pair in chosen for end in pairs[pair][0]]
                if len(ends) == len(set(ends)) and not any({j, k} <= set(chosen) for j, k in opposed):
                    gains.append(float(gain[list(chosen)].sum()))
        return max(gains)

    matched = matching_without_conflicts(a, b, gain, conflicts)
    assert not any({j, k} <= set(matched.tolist()) for j, k in opposed)
    assert gain[matched].sum() == best()
    for pair, margin in zip(matched, matching_margins(matched, a, b, gain, conflicts), strict=True):
        assert margin == best() - best(pair)


def test_conflicts_are_broken_if_there_are_too_many_branches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recognition.geometry.graph_matching, "MAX_BRANCHES", 1)
    a, b, gain = arrays([((0, 1), 2), ((2, 3), 5), ((4, 5), 3)])
    conflicts = np.array([(0, 1), (1, 2)])
    matched = set(matching_without_conflicts(a, b, gain, conflicts).tolist())
    assert not any({j, k} <= matched for j, k in conflicts.tolist())


def test_equally_good_matchings_are_decided_the_same_each_time() -> None:
    # Two answers gain 3. Releases of rustworkx before 0.18 return either of them.
    pairs = arrays([((0, 2), 2), ((0, 4), 1), ((1, 4), 1), ((2, 4), 2), ((3, 4), 1)])
    answers = {tuple(maximum_weight_matching(*pairs)) for _ in range(50)}
    assert len(answers) == 1


def test_margins_are_zero_if_too_many_ends_compete(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recognition.geometry.graph_matching, "MAX_COMPETING_ENDS", 2)
    a, b, gain = arrays([((0, 1), 2), ((2, 3), 5), ((3, 4), 3)])
    assert matching_margins(maximum_weight_matching(a, b, gain), a, b, gain).tolist() == [2.0, 0.0]


def test_a_thousand_ends_are_matched() -> None:
    # Far more than real scenes have. A search over all sets would not end.
    rng = np.random.default_rng(1)
    a, b = np.unique(np.sort(rng.integers(0, 1000, (5000, 2)), axis=1), axis=0).T
    a, b = a[a != b], b[a != b]
    matched = maximum_weight_matching(a, b, rng.uniform(0.5, 1.0, len(a)))
    assert len(set(a[matched]) | set(b[matched])) == 2 * len(matched) > 900
