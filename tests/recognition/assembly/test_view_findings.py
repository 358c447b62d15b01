"""Notes on excluded views, and doubts about a scene that changed and about the calibration."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.view_findings import MAX_LISTED_VIEWS, drift_findings, view_findings
from recognition.model.chains import Chain
from recognition.model.findings import finding
from recognition.model.quality import ViewQuality
from recognition.registration.registration import Registration

USED = ViewQuality(0, True, None, 500)


def chain(number: int) -> Chain:
    points = np.array([(0, 0, 0.004), (0.1, 0, 0.004)])
    return Chain(number, False, 0.004, points, np.full(2, 1e-4), np.full(2, 8, dtype=np.int64), ("free", "free"))


CHAINS = (chain(0), chain(1))


def excluded(index: int, code: str) -> ViewQuality:
    return ViewQuality(index, False, "its reason", 0, code=code)  # type: ignore[arg-type]  # a code of the table


def test_each_excluded_view_is_a_note_with_its_index_and_reason() -> None:
    views = [USED, excluded(1, "view-without-depth"), excluded(4, "view-pose-error"), replace(USED, index=5)]
    findings = view_findings(views, [0, 1, 4, 5], CHAINS)
    assert [(found.code, found.severity, found.view) for found in findings] == [
        ("view-without-depth", "note", 1),
        ("view-pose-error", "note", 4),
    ]
    assert [found.message for found in findings] == [f"view {k} was excluded: its reason" for k in (1, 4)]
    assert all(found.chains == () for found in findings)


def test_many_views_excluded_for_one_cause_have_one_note() -> None:
    noisy = [replace(excluded(k, "view-noisy"), points=100 * k, reason=f"reason {k}") for k in range(1, 26)]
    found, stuck = view_findings([USED, *noisy, excluded(30, "view-stuck")], range(31), CHAINS)
    assert (found.code, found.view, stuck.code) == ("view-noisy", 25, "view-stuck")
    assert found.message.startswith("25 views were excluded for one cause (1, 2, 3, ")
    assert found.message.endswith("for example view 25: reason 25")
    assert len(view_findings([USED, *noisy[:MAX_LISTED_VIEWS]], range(4), CHAINS)) == MAX_LISTED_VIEWS


def test_used_views_give_no_finding() -> None:
    assert view_findings([USED, replace(USED, index=1)], [1, 0], CHAINS) == []
    assert view_findings([], [], ()) == []


def test_a_view_of_the_empty_table_is_noted_only_if_other_views_show_a_string() -> None:
    views = [excluded(0, "view-without-string"), excluded(1, "view-stuck")]
    assert [found.code for found in view_findings(views, [0, 1], CHAINS)] == ["view-without-string", "view-stuck"]
    assert [found.code for found in view_findings(views, [0, 1], ())] == ["view-stuck"]


def contradicting(*indices: int) -> list[ViewQuality]:
    """Return eight views. Those with the given indices contradict the others."""
    return [excluded(k, "view-contradicting") if k in indices else replace(USED, index=k) for k in range(8)]


def codes(views: Sequence[ViewQuality], captured: Sequence[int]) -> list[str]:
    return [found.code for found in view_findings(views, captured, CHAINS)]


def test_the_scene_may_have_changed_if_all_views_contradict_from_one_on() -> None:
    *notes, doubt = view_findings(contradicting(6, 7), range(8), CHAINS)
    assert [(note.code, note.view) for note in notes] == [("view-contradicting", 6), ("view-contradicting", 7)]
    assert (doubt.code, doubt.severity, doubt.chains, doubt.view) == ("scene-changed", "doubt", (0, 1), 6)


def test_the_order_of_capture_counts_and_not_the_index() -> None:
    order = [6, 5, 7, 0, 1, 2, 4, 3]
    assert "scene-changed" in codes(contradicting(3, 4), order)
    assert "scene-changed" not in codes(contradicting(7), order)


@pytest.mark.parametrize("indices", [(0,), (3,), (3, 7), (0, 6, 7)])
def test_a_used_view_after_a_contradicting_one_shows_that_nothing_moved(indices: tuple[int, ...]) -> None:
    assert codes(contradicting(*indices), range(8)) == ["view-contradicting"] * len(indices)


def test_another_reason_is_no_change() -> None:
    views = [*contradicting()[:7], excluded(7, "view-pose-error")]
    assert codes(views, range(8)) == ["view-pose-error"]


def test_a_drift_of_the_calibration_concerns_all_chains(registered: Callable[..., Registration]) -> None:
    points = np.array([(0.0, 0.0, 0.004)])
    registration = registered([(points, np.array([(0.0, 0.0, 1.0)]))])
    assert drift_findings(registration, CHAINS) == []
    drift = finding("calibration-drift", "message", value=9.0, limit=4.0)
    (found,) = drift_findings(replace(registration, hand_eye_drift=drift), CHAINS)
    assert found == replace(drift, chains=(0, 1))
