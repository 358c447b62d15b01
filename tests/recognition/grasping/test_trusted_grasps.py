"""Grasps on parts of chains with a doubt are removed, or kept and marked."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from recognition.grasping.grasp_planner import GraspSet
from recognition.grasping.trusted_grasps import select_trusted_grasps
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.findings import Finding, finding
from recognition.model.grasps import ScoredGrasp
from recognition.model.trust import CROSSING_PART_RADII
from tests.recognition.straight_strings import GRIPPER, HALF_FINGER, R, chain, grasps_of, straight

STRINGS = (straight(), straight(y=0.1, number=1))
"""Two strings of 0.2 m."""
CANDIDATES = GraspSet(*grasps_of(*STRINGS))


def selected(*findings: Finding, keep_all: bool = False, crossings: tuple[Crossing, ...] = ()) -> GraspSet:
    return select_trusted_grasps(CANDIDATES, STRINGS, crossings, findings, GRIPPER, keep_all)


def doubt(start_m: float, stop_m: float, number: int = 0) -> Finding:
    return finding("connection-uncertain", "m", chains=(number,), s_range_m=(start_m, stop_m))


def keys(grasps: Sequence[ScoredGrasp]) -> list[tuple[int, float, float]]:
    """Return what identifies the grasps, in their order."""
    return [(grasp.chain, grasp.s_m, grasp.score) for grasp in grasps]


def test_without_doubts_all_grasps_are_kept() -> None:
    assert CANDIDATES.grasps
    for findings in ((), (finding("radius-larger", "a note", chains=(0,)), finding("possible-string", "elsewhere"))):
        found = selected(*findings)
        assert keys(found.grasps) == keys(CANDIDATES.grasps)
        assert all(grasp.trusted for grasp in found.grasps)
        assert found.findings == ()


@pytest.mark.parametrize("half_m", [0.0004, 0.0012, 0.0312])
def test_no_finger_holds_a_part_with_a_doubt_and_no_other_grasp_is_lost(half_m: float) -> None:
    found = selected(doubt(0.1 - half_m, 0.1 + half_m))
    expected = [grasp for grasp in CANDIDATES.grasps if grasp.chain == 1 or abs(grasp.s_m - 0.1) > half_m + HALF_FINGER]
    assert len(expected) < len(CANDIDATES.grasps)
    assert keys(found.grasps) == keys(expected)
    assert found.findings == ()


def test_all_grasps_are_kept_and_marked_on_request() -> None:
    found = selected(doubt(0.0712, 0.1288), keep_all=True)
    assert keys(found.grasps) == keys(CANDIDATES.grasps)
    for grasp in found.grasps:
        assert grasp.trusted == (grasp.chain == 1 or abs(grasp.s_m - 0.1) > 0.0288 + HALF_FINGER)
    assert found.findings == ()


def test_a_chain_whose_grasps_were_all_removed_gets_a_note() -> None:
    found = selected(finding("above-table", "the whole chain", chains=(1,)))
    assert {grasp.chain for grasp in found.grasps} == {0}
    (note,) = found.findings
    count = sum(grasp.chain == 1 for grasp in CANDIDATES.grasps)
    assert (note.code, note.severity, note.chains, note.value) == ("no-trusted-grasp", "note", (1,), count)
    assert f"has {count} grasps" in note.message
    kept = selected(finding("above-table", "the whole chain", chains=(1,)), keep_all=True)
    assert kept.findings == ()
    assert {grasp.chain for grasp in kept.grasps if not grasp.trusted} == {1}


def test_a_chain_without_candidates_keeps_its_own_note() -> None:
    note = finding("no-grasp", "chain 1 cannot be grasped", chains=(1,))
    candidates = GraspSet(tuple(grasp for grasp in CANDIDATES.grasps if grasp.chain == 0), (note,))
    whole = finding("above-table", "both", chains=(0, 1))
    found = select_trusted_grasps(candidates, STRINGS, (), (whole,), GRIPPER)
    assert found.grasps == ()
    assert [(one.code, one.chains) for one in found.findings] == [("no-grasp", (1,)), ("no-trusted-grasp", (0,))]


def test_a_refused_model_has_no_trusted_grasp() -> None:
    found = selected(finding("sharp-bend", "the whole model"))
    assert found.grasps == ()
    assert [note.chains for note in found.findings] == [(0,), (1,)]


def test_no_grasp_beside_an_undecided_crossing() -> None:
    x = Crossing(0, np.zeros(3), StrandPoint(0, 0.1), StrandPoint(1, 0.05), 2 * R, 1.0, 1, 0.6)
    found = selected(finding("crossing-undecided", "m", chains=(0, 1), crossing=0), crossings=(x,))
    half = CROSSING_PART_RADII * R + HALF_FINGER
    for number, s in ((0, 0.1), (1, 0.05)):
        distances = [abs(grasp.s_m - s) for grasp in found.grasps if grasp.chain == number]
        # Candidates are 5 mm apart.
        assert half < min(distances) < half + 0.005


def ring() -> Chain:
    t = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    return chain(0.06 * np.column_stack([np.cos(t), np.sin(t), 0 * t]) + STRINGS[0].points[0] * (0, 0, 1), closed=True)


def test_a_finger_across_the_first_point_of_a_ring_holds_both_sides() -> None:
    one = ring()
    candidates = GraspSet(*grasps_of(one))
    # A doubt about the last millimetre.
    findings = (doubt(one.length_m - 0.001, one.length_m),)
    found = select_trusted_grasps(candidates, (one,), (), findings, GRIPPER, keep_all=True)
    for grasp in found.grasps:
        after = min(grasp.s_m, abs(grasp.s_m - one.length_m))
        before = max(one.length_m - 0.001 - grasp.s_m, 0.0)
        assert grasp.trusted == (min(after, before) > HALF_FINGER)
    assert any(not grasp.trusted and grasp.s_m < HALF_FINGER for grasp in found.grasps)


def test_no_candidates_no_grasps() -> None:
    assert select_trusted_grasps(GraspSet((), ()), (), (), (), GRIPPER) == GraspSet((), ())
    wide = replace(GRIPPER, finger_width_m=0.02)
    fewer = select_trusted_grasps(CANDIDATES, STRINGS, (), (doubt(0.1, 0.1),), wide).grasps
    assert len(fewer) < len(selected(doubt(0.1, 0.1)).grasps), "a wider finger holds more of the string"
