"""Verdicts on the model, on chains, on crossings and on positions, by each rule, on strings along a line."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.findings import Finding, finding
from recognition.model.model import PointChainModel
from recognition.model.quality import Quality
from recognition.model.trust import (
    CROSSING_PART_RADII,
    ChainTrust,
    Interval,
    Verdict,
    chain_trust,
    crossing_verdict,
    model_verdict,
)
from recognition.parameters import ChainParameters

R = 0.0042
LENGTH = 0.2
RING_LENGTH = 0.4
HALF = CROSSING_PART_RADII * R

PART_DOUBT, PART_BLOCK = "connection-uncertain", "sharp-bend"
"""A doubt and a blocking finding."""


def chain(number: int, closed: bool = False) -> Chain:
    """Return a string of 0.2 m along x, or a square ring of 0.4 m, with points 10 mm apart."""
    if closed:
        t = np.arange(0, RING_LENGTH, 0.01)
        side, rest = np.divmod(t, 0.1)
        x = np.choose(side.astype(int), [rest, 0.1 + 0 * rest, 0.1 - rest, 0 * rest])
        y = np.choose(side.astype(int), [0 * rest, rest, 0.1 + 0 * rest, 0.1 - rest])
    else:
        x = np.linspace(0, LENGTH, 21)
        y = 0 * x
    n = len(x)
    points = np.column_stack([x, y, np.full(n, R)])
    return Chain(number, closed, R, points, np.full(n, 3e-4), np.full(n, 5, dtype=np.int64), ("free", "free"))


def crossing(number: int, over: tuple[int, float], under: tuple[int, float]) -> Crossing:
    return Crossing(number, np.zeros(3), StrandPoint(*over), StrandPoint(*under), 2 * R, 1.0, 1, 0.99)


def found(severity: str, **members: Any) -> Finding:
    """Return a finding of a severity."""
    code = {"note": "radius-larger", "doubt": PART_DOUBT, "blocking": PART_BLOCK}[severity]
    made = finding(code, "message", **members)  # type: ignore[arg-type]  # a key of the table
    assert made.severity == severity
    return made


STRING, OTHER, RING = chain(0), chain(1), chain(2, closed=True)


def doubtful(one: Chain, *findings: Finding, crossings: tuple[Crossing, ...] = ()) -> tuple[Interval, ...]:
    """Return the doubtful parts of a chain, after checking that the trusted parts are the rest."""
    trust = chain_trust(one, crossings, findings)
    parts = sorted((*trust.doubtful_m, *trust.trusted_m))
    assert parts[0][0] == 0.0
    assert parts[-1][1] == one.length_m
    assert all(stop == start for (_, stop), (start, _) in pairwise(parts))
    return trust.doubtful_m


# --- model ---


@pytest.mark.parametrize(
    ("findings", "verdict"),
    [
        ((), "accept"),
        ((found("note"), found("note", chains=(0,))), "accept"),
        ((found("doubt"),), "review"),
        ((found("note"), found("doubt", chains=(0,))), "review"),
        ((found("blocking", chains=(0,)),), "review"),
        ((found("blocking", chains=(0,), s_range_m=(0.0, 0.1)),), "review"),
        ((found("blocking"),), "refuse"),
        ((found("doubt"), found("note"), found("blocking")), "refuse"),
    ],
)
def test_a_model_is_refused_by_a_blocking_finding_without_chains_and_reviewed_by_other_doubts(
    findings: tuple[Finding, ...], verdict: Verdict
) -> None:
    assert model_verdict(findings) == verdict


def test_a_refused_model_has_only_refused_chains_and_crossings() -> None:
    findings = (found("blocking"),)
    trusts = [chain_trust(one, (), findings) for one in (STRING, RING)]
    assert [trust.verdict for trust in trusts] == ["refuse", "refuse"]
    assert [trust.trusted_m for trust in trusts] == [(), ()]
    assert crossing_verdict(crossing(0, (0, 0.1), (2, 0.1)), trusts, findings) == "refuse"


def test_a_doubt_without_chains_concerns_no_chain() -> None:
    findings = (found("doubt"),)
    assert chain_trust(STRING, (), findings) == ChainTrust("accept", LENGTH, False, ())
    assert model_verdict(findings) == "review"


# --- chains ---


def test_notes_change_nothing() -> None:
    x = crossing(0, (0, 0.05), (0, 0.15))
    notes = (
        found("note"),
        found("note", chains=(0,)),
        found("note", chains=(0,), s_range_m=(0.05, 0.1)),
        found("note", chains=(0,), crossing=0),
    )
    trust = chain_trust(STRING, (x,), notes)
    assert trust == chain_trust(STRING, (x,), ()) == ChainTrust("accept", STRING.length_m, False, ())
    assert trust.trusted_m == ((0.0, STRING.length_m),)
    assert crossing_verdict(x, (trust, trust), notes) == "accept"


@pytest.mark.parametrize(("severity", "verdict"), [("doubt", "review"), ("blocking", "refuse")])
@pytest.mark.parametrize("one", [STRING, RING], ids=["open", "closed"])
def test_a_finding_on_a_whole_chain_leaves_nothing_trusted(severity: str, verdict: Verdict, one: Chain) -> None:
    trust = chain_trust(one, (), (found(severity, chains=(one.id,)),))
    assert (trust.verdict, trust.trusted_m) == (verdict, ())
    assert not any(trust.is_trusted(s) for s in (0.0, 0.1, one.length_m))
    # A chain that it does not name is not concerned.
    assert chain_trust(OTHER, (), (found(severity, chains=(one.id,)),)).verdict == "accept"


@pytest.mark.parametrize("severity", ["doubt", "blocking"])
def test_a_finding_on_a_part_leaves_the_rest_trusted(severity: str) -> None:
    trust = chain_trust(STRING, (), (found(severity, chains=(0,), s_range_m=(0.05, 0.08)),))
    assert trust.verdict == "review"
    assert trust.trusted_m == ((0.0, 0.05), (0.08, LENGTH))
    assert [trust.is_trusted(s) for s in (0.0, 0.049, 0.05, 0.07, 0.08, 0.081, LENGTH)] == [
        True, True, False, False, False, True, True,
    ]  # fmt: skip


def test_a_doubt_about_the_whole_chain_outweighs_a_blocking_part_and_a_blocking_chain_outweighs_all() -> None:
    part = found("blocking", chains=(0,), s_range_m=(0.05, 0.08))
    whole = found("doubt", chains=(0,))
    assert chain_trust(STRING, (), (part, whole)).verdict == "review"
    assert chain_trust(STRING, (), (part, whole)).trusted_m == ()
    assert chain_trust(STRING, (), (part, whole, found("blocking", chains=(0, 1)))).verdict == "refuse"


def test_parts_at_the_ends_overlapping_parts_and_adjacent_parts() -> None:
    def parts(*spans: Interval) -> tuple[Interval, ...]:
        return doubtful(STRING, *(found("doubt", chains=(0,), s_range_m=span) for span in spans))

    length = STRING.length_m
    assert parts((0.0, 0.02)) == ((0.0, 0.02),)
    assert parts((0.18, length)) == ((0.18, length),)
    assert parts((0.05, 0.1), (0.08, 0.12), (0.15, 0.16)) == ((0.05, 0.12), (0.15, 0.16))
    assert parts((0.08, 0.12), (0.05, 0.08)) == ((0.05, 0.12),)
    assert parts((0.05, 0.15), (0.08, 0.1)) == ((0.05, 0.15),)
    # Beyond the ends of an open chain there is nothing.
    assert parts((-0.02, 0.01), (0.19, 0.3)) == ((0.0, 0.01), (0.19, length))
    assert parts((0.3, 0.4)) == ()
    assert parts((-1.0, 1.0)) == ((0.0, length),)


def test_a_part_of_a_ring_wraps_around_its_first_point() -> None:
    def parts(start: float, stop: float) -> tuple[Interval, ...]:
        return doubtful(RING, found("doubt", chains=(2,), s_range_m=(start, stop)))

    length = RING.length_m
    assert length == pytest.approx(RING_LENGTH, abs=1e-12)
    for turn in (-length, 0.0, length):
        for (start, stop), expected in (
            ((0.38, 0.42), ((0.0, 0.42 - length), (0.38, length))),
            ((0.1, 0.15), ((0.1, 0.15),)),
        ):
            found_parts = parts(start + turn, stop + turn)
            np.testing.assert_allclose(found_parts, expected, rtol=0, atol=1e-12)
    trust = chain_trust(RING, (), (found("doubt", chains=(2,), s_range_m=(0.38, 0.42)),))
    assert [trust.is_trusted(s) for s in (0.0, 0.019, 0.021, 0.2, 0.379, 0.381, length)] == [
        False, False, True, True, True, False, False,
    ]  # fmt: skip
    # A finger across the first point.
    short = chain_trust(RING, (), (found("doubt", chains=(2,), s_range_m=(0.39, 0.395)),))
    assert short.is_trusted(0.0)
    assert not short.is_trusted(0.0, half_length_m=0.006)
    assert short.is_trusted(0.0, half_length_m=0.004)
    # More than one turn.
    assert parts(0.1, 0.6) == ((0.0, length),)


@given(
    closed=st.booleans(),
    spans=st.lists(st.tuples(st.floats(-0.1, 0.5), st.floats(0.001, 0.2)), max_size=5),
    s=st.floats(0, 1),
)
def test_a_position_is_trusted_if_and_only_if_no_part_contains_it(
    closed: bool, spans: list[tuple[float, float]], s: float
) -> None:
    one = RING if closed else STRING
    findings = [found("doubt", chains=(one.id,), s_range_m=(start, start + width)) for start, width in spans]
    trust = chain_trust(one, (), findings)
    position = s * one.length_m
    turns = (-one.length_m, 0.0, one.length_m) if closed else (0.0,)
    distances = [
        max(start - position - turn, position + turn - start - width) for start, width in spans for turn in turns
    ]
    # Within the rounding of 10 micrometres it may be either.
    if all(abs(distance) > 2e-5 for distance in distances):
        assert trust.is_trusted(position) == all(distance > 0 for distance in distances)
        assert trust.is_trusted(position) == any(a <= position <= b for a, b in trust.trusted_m)


def test_a_position_beyond_an_end_counts_as_the_end() -> None:
    trust = chain_trust(STRING, (), (found("doubt", chains=(0,), s_range_m=(0.18, STRING.length_m)),))
    assert not trust.is_trusted(STRING.length_m + 1e-6)
    assert trust.is_trusted(-1e-6)


def test_rounded_parts_reach_the_end_of_a_chain_that_is_a_little_longer() -> None:
    # As in a document: the arc length is rounded, and the length is that of rounded points.
    for stop in (STRING.length_m - 2e-6, STRING.length_m, STRING.length_m + 2e-6):
        trust = chain_trust(STRING, (), (found("doubt", chains=(0,), s_range_m=(0.18, stop)),))
        assert trust.trusted_m == ((0.0, 0.18),)
        assert not trust.is_trusted(STRING.length_m)
    trust = chain_trust(STRING, (), (found("doubt", chains=(0,), s_range_m=(1e-6, 0.02)),))
    assert trust.trusted_m == ((0.02, STRING.length_m),)
    # Two parts that meet leave nothing between them.
    halves = [found("doubt", chains=(0,), s_range_m=span) for span in ((0.0, 0.1), (0.100002, STRING.length_m))]
    assert chain_trust(STRING, (), halves).trusted_m == ()


# --- crossings ---


def test_a_finding_on_a_crossing_concerns_both_of_its_passes() -> None:
    x = crossing(7, (0, 0.05), (1, 0.15))
    doubt = found("doubt", chains=(0, 1), crossing=7)
    np.testing.assert_allclose(doubtful(STRING, doubt, crossings=(x,)), [(0.05 - HALF, 0.05 + HALF)], atol=1e-12)
    np.testing.assert_allclose(doubtful(OTHER, doubt, crossings=(x,)), [(0.15 - HALF, 0.15 + HALF)], atol=1e-12)
    trusts = [chain_trust(one, (x,), (doubt,)) for one in (STRING, OTHER)]
    assert [trust.verdict for trust in trusts] == ["review", "review"]
    assert crossing_verdict(x, trusts, (doubt,)) == "review"


def test_a_finding_on_a_crossing_of_a_chain_with_itself_concerns_two_parts() -> None:
    x, other = crossing(0, (0, 0.05), (0, 0.15)), crossing(1, (0, 0.1), (1, 0.1))
    doubt = found("doubt", chains=(0,), crossing=0)
    parts = doubtful(STRING, doubt, crossings=(x, other))
    np.testing.assert_allclose(parts, [(0.05 - HALF, 0.05 + HALF), (0.15 - HALF, 0.15 + HALF)], atol=1e-12)
    trusts = [chain_trust(one, (x, other), (doubt,)) for one in (STRING, OTHER)]
    assert crossing_verdict(other, trusts, (doubt,)) == "accept"
    assert trusts[1].verdict == "accept"


def test_a_crossing_near_an_end_and_at_the_first_point_of_a_ring() -> None:
    x = crossing(0, (0, 0.005), (2, 0.002))
    doubt = found("doubt", chains=(0, 2), crossing=0)
    np.testing.assert_allclose(doubtful(STRING, doubt, crossings=(x,)), [(0, 0.005 + HALF)], atol=1e-12)
    np.testing.assert_allclose(
        doubtful(RING, doubt, crossings=(x,)),
        [(0, 0.002 + HALF), (RING_LENGTH + 0.002 - HALF, RING_LENGTH)],
        atol=1e-12,
    )


@pytest.mark.parametrize("severity", ["doubt", "blocking"])
def test_a_crossing_on_a_doubtful_part_is_reviewed(severity: str) -> None:
    inside, outside = crossing(0, (1, 0.1), (0, 0.06)), crossing(1, (1, 0.12), (0, 0.16))
    findings = (found(severity, chains=(0,), s_range_m=(0.05, 0.08)),)
    for x, verdict in ((inside, "review"), (outside, "accept")):
        trusts = [chain_trust(one, (inside, outside), findings) for one in (OTHER, STRING)]
        assert crossing_verdict(x, trusts, findings) == verdict


def test_a_crossing_of_a_refused_chain_is_refused() -> None:
    x = crossing(0, (0, 0.1), (1, 0.1))
    findings = (found("blocking", chains=(1,)), found("doubt", chains=(0, 1), crossing=0))
    assert crossing_verdict(x, [chain_trust(one, (x,), findings) for one in (STRING, OTHER)], findings) == "refuse"


def test_a_doubtful_crossing_is_reviewed_if_its_finding_names_no_chain() -> None:
    x = crossing(0, (0, 0.1), (1, 0.1))
    findings = (found("doubt", crossing=0),)
    trusts = [chain_trust(one, (x,), findings) for one in (STRING, OTHER)]
    assert crossing_verdict(x, trusts, findings) == "review"
    assert [trust.verdict for trust in trusts] == ["accept", "accept"]


# --- the model applies the rules ---


def test_the_model_gives_the_verdicts_on_its_chains_crossings_and_positions(table_1: ChainParameters) -> None:
    crossings = (crossing(0, (0, 0.05), (1, 0.05)), crossing(1, (1, 0.15), (2, 0.3)))
    findings = (found("doubt", chains=(0, 1), crossing=0), found("note", chains=(2,)))
    model = PointChainModel("graph", table_1, (STRING, OTHER, RING), crossings, Quality(findings=findings))
    assert model.quality.verdict == "review"
    assert model.quality.doubts == findings[:1]
    assert [model.chain_trust(k).verdict for k in range(3)] == ["review", "review", "accept"]
    assert [model.crossing_verdict(k) for k in range(2)] == ["review", "accept"]
    assert [model.trusted(k) for k in range(3)] == [False, False, True]
    assert [model.trusted(0, s) for s in (0.0, 0.05, 0.1)] == [True, False, True]


def test_unknown_chains_and_crossings_are_key_errors(table_1: ChainParameters) -> None:
    model = PointChainModel("graph", table_1, (STRING,))
    with pytest.raises(KeyError, match="no item with the id 5"):
        model.chain_trust(5)
    with pytest.raises(KeyError, match="no item with the id 0"):
        model.crossing_verdict(0)
    with pytest.raises(KeyError, match="no item with the id 1"):
        model.trusted(1, 0.1)
