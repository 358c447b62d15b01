"""Doubts about pairs of ends that were joined with a small margin: which part of which chain they concern."""

import numpy as np
import pytest
from numpy.typing import NDArray

from recognition.assembly.connections import MARGIN_RADII, connection_findings
from recognition.model.chains import Chain
from recognition.tracing.end_pairing import MIN_CERTAIN_MARGIN, AmbiguousPair

R = 0.004
STEP = 0.004


def chain(number: int, points: NDArray[np.float64], closed: bool = False) -> Chain:
    n = len(points)
    return Chain(number, closed, R, points, np.full(n, 1e-4), np.full(n, 8, dtype=np.int64), ("free", "free"))


def along_x(number: int, y: float = 0.0, z: float = R) -> Chain:
    """Return a string of 0.2 m along x, with points 4 mm apart."""
    x = np.arange(51) * STEP
    return chain(number, np.column_stack([x, np.full(51, y), np.full(51, z)]))


def pair(a: tuple[float, float], b: tuple[float, float], margin: float = 0.5) -> AmbiguousPair:
    return AmbiguousPair(np.array([(*a, R), (*b, R)]), margin)


def test_the_doubt_concerns_the_gap_and_two_radii_on_both_sides() -> None:
    (found,) = connection_findings([pair((0.09, 0.0), (0.11, 0.0))], [along_x(0), along_x(1, y=0.1)])
    assert (found.code, found.severity, found.chains) == ("connection-uncertain", "doubt", (0,))
    assert found.point_m == pytest.approx((0.1, 0.0, R), abs=1e-12)
    assert (found.value, found.limit) == (0.5, MIN_CERTAIN_MARGIN)
    assert found.message.startswith(
        "chain 0, 84 to 116 mm along it: the strands at (100, 0, 4) mm may be connected differently"
    )
    # 10 mm and 8 mm on both sides, to the next point within this distance.
    assert found.s_range_m == pytest.approx((0.084, 0.116), abs=1e-9)
    reach = 0.01 + MARGIN_RADII * R
    assert found.s_range_m is not None
    assert 0.1 - reach <= found.s_range_m[0] < 0.1 - reach + STEP


def test_a_gap_that_two_chains_pass_gives_a_doubt_about_each() -> None:
    across = chain(1, along_x(1).points[:, [1, 0, 2]] + (0.1, -0.1, 2 * R))
    findings = connection_findings([pair((0.095, 0.0), (0.105, 0.0))], [along_x(0), across])
    assert [found.chains for found in findings] == [(0,), (1,)]
    # 13 mm around the middle of the gap, at which the second chain is 8 mm higher.
    parts = [found.s_range_m for found in findings]
    assert parts == [pytest.approx((0.088, 0.112), abs=1e-9), pytest.approx((0.092, 0.108), abs=1e-9)]


def test_a_chain_that_passes_a_gap_twice_has_two_parts() -> None:
    there = along_x(0).points
    back = there[::-1] + (0.0, 0.008, 0.0)
    findings = connection_findings([pair((0.1, -0.002), (0.1, 0.01))], [chain(0, np.vstack([there, back]))])
    assert [found.chains for found in findings] == [(0,), (0,)]
    parts = [found.s_range_m for found in findings]
    length = 0.2 + 0.008
    # Within 14 mm of (100, 4) mm, which is 4 mm from both lines.
    assert parts == [pytest.approx((0.088, 0.112)), pytest.approx((length + 0.088, length + 0.112))]


def ring(first: int) -> Chain:
    """Return a square ring of 40 mm sides, with points 4 mm apart, which begins at its point number `first`."""
    t = np.arange(40) * STEP
    side, s = np.divmod(np.round(t, 9), 0.04)
    x = np.choose(side.astype(int), [s, 0.04 + 0 * s, 0.04 - s, 0 * s])
    y = np.choose(side.astype(int), [0 * s, s, 0.04 + 0 * s, 0.04 - s])
    return chain(0, np.roll(np.column_stack([x, y, np.full(40, R)]), -first, axis=0), closed=True)


@pytest.mark.parametrize("first", range(40))
def test_a_part_of_a_ring_is_one_part_wherever_the_ring_begins(first: int) -> None:
    # In the middle of the first side: from point 2 to point 8, 24 mm.
    one = ring(first)
    (found,) = connection_findings([pair((0.016, 0.0), (0.024, 0.0))], [one])
    assert found.s_range_m is not None
    start, stop = found.s_range_m
    assert stop - start == pytest.approx(0.024, abs=1e-9)
    assert start == pytest.approx((2 - first) % 40 * STEP, abs=1e-9)
    assert 0 <= start < one.length_m


def test_a_ring_within_a_gap_is_doubtful_as_a_whole() -> None:
    one = ring(0)
    (found,) = connection_findings([pair((-0.03, 0.02), (0.07, 0.02))], [one])
    assert found.s_range_m == pytest.approx((0.0, one.length_m), abs=1e-12)


def test_without_pairs_or_chains_there_is_no_doubt() -> None:
    assert connection_findings([], [along_x(0)]) == []
    assert connection_findings([pair((0.09, 0.0), (0.11, 0.0))], []) == []
    # The strand of the pair was excluded.
    assert connection_findings([pair((0.09, 0.1), (0.11, 0.1))], [along_x(0)]) == []
