"""Verdicts and findings of right and wrong models are counted."""

from dataclasses import replace
from typing import Any

import pytest

from cell.simulation.benchmark.finding_counts import MIN_COVER, count_findings, model_findings
from cell.simulation.evaluation.metrics import Score

RIGHT = Score("a scene", 1, 1, 2, 0, 0, 0.0002, 0.0004, 0.0001, 0.0005, 1.0, True, 0)


def document(verdict: str, *codes: tuple[str, str]) -> dict[str, Any]:
    return {
        "quality": {"verdict": verdict, "findings": [{"code": code, "severity": severity} for code, severity in codes]}
    }


def test_each_code_counts_once_in_a_model() -> None:
    note, doubt = ("piece-too-short", "note"), ("possible-bar", "doubt")
    findings = model_findings(document("review", doubt, note, note))
    assert (findings.verdict, findings.codes) == ("review", (doubt, note))


def test_verdicts_of_right_and_wrong_models_are_separate() -> None:
    accepted = model_findings(document("accept", ("piece-too-short", "note")))
    reviewed = model_findings(document("review", ("possible-bar", "doubt"), ("piece-too-short", "note")))
    wrong, cut_short = replace(RIGHT, topology=False), replace(RIGHT, cover=MIN_COVER - 0.01)
    counts = count_findings([(RIGHT, accepted), (RIGHT, reviewed), (wrong, reviewed), (cut_short, accepted)])
    assert counts.right == {"accept": 1, "review": 1, "refuse": 0}
    assert counts.wrong == {"accept": 1, "review": 1, "refuse": 0}
    assert counts.codes == {"note piece-too-short": 4, "doubt possible-bar": 2}


def test_no_models_no_counts() -> None:
    counts = count_findings([])
    assert (sum(counts.right.values()), sum(counts.wrong.values()), counts.codes) == (0, 0, {})


@pytest.mark.parametrize("broken", [{}, {"quality": {}}])
def test_a_document_without_findings_is_no_model(broken: dict[str, Any]) -> None:
    with pytest.raises(KeyError):
        model_findings(broken)
