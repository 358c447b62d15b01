"""Count the verdicts and the findings of the models of the benchmark, separately for right and wrong models."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from cell.simulation.evaluation.metrics import Score
from recognition.model.trust import Verdict

MIN_COVER = 0.95
"""Minimum share of the true lines that a right model covers. The topology alone does not show a string cut short."""


@dataclass(frozen=True)
class ModelFindings:
    """Verdict and findings of one model."""

    verdict: Verdict
    """Verdict on the whole model."""
    codes: tuple[tuple[str, str], ...]
    """Code and severity of its findings, each pair once."""


@dataclass(frozen=True)
class FindingCounts:
    """Verdicts and findings of several models."""

    right: Mapping[Verdict, int]
    """Number of right models with each verdict."""
    wrong: Mapping[Verdict, int]
    """Number of wrong models with each verdict."""
    codes: Mapping[str, int]
    """Number of models with each finding. The key is the severity and the code, for example `note piece-too-short`."""


def model_findings(model: Mapping[str, Any]) -> ModelFindings:
    """Return the verdict and the findings of a model document."""
    quality = model["quality"]
    codes = {(found["code"], found["severity"]): None for found in quality["findings"]}
    return ModelFindings(quality["verdict"], tuple(codes))


def count_findings(cases: Sequence[tuple[Score, ModelFindings]]) -> FindingCounts:
    """Count the verdicts and the findings of models with a score.

    A model is right if its topology is right and it covers `MIN_COVER` of the true lines.
    """
    counts: dict[bool, Counter[Verdict]] = {True: Counter(), False: Counter()}
    codes: Counter[str] = Counter()
    for score, findings in cases:
        counts[score.topology and score.cover >= MIN_COVER][findings.verdict] += 1
        codes.update(f"{severity} {code}" for code, severity in findings.codes)
    right, wrong = ({verdict: counts[is_right][verdict] for verdict in get_args(Verdict)} for is_right in (True, False))
    return FindingCounts(right, wrong, dict(codes.most_common()))
