"""Quality of a model: how each view was used, the findings, and the verdict."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Self

from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding, most_serious_first
from recognition.model.trust import Verdict, model_verdict


@dataclass(frozen=True)
class ExclusionReason:
    """Why recognition does not use a view."""

    code: FindingCode
    """Code of the finding on the view."""
    message: str
    """Description for people."""


@dataclass(frozen=True)
class ViewQuality:
    """How recognition used one view."""

    index: int
    """Index of the view."""
    used: bool
    """Whether the view is part of the model."""
    reason: str | None
    """Why the view was excluded; None if it was used."""
    points: int
    """Number of points above the height threshold."""
    fitness: float | None = None
    """Share of the points that have a point of another view on the same surface within r, 0 to 1; None for a single
    view."""
    rms_m: float | None = None
    """Root mean square distance of these points from the surface of the other views, metres."""
    correction_m: float | None = None
    """Translation of the centroid of the view by alignment to the table and registration, metres."""
    correction_rad: float | None = None
    """Rotation of the view by alignment to the table and registration, radians."""
    code: FindingCode | None = None
    """Code of the finding on an excluded view; None if the view was used."""


@dataclass(frozen=True)
class Quality:
    """Whether the model can be trusted. Read this before you use the rest of the model."""

    views: tuple[ViewQuality, ...] = ()
    """One entry per view, by index."""
    findings: tuple[Finding, ...] = ()
    """What was excluded, what is uncertain, and what must not be used, the most serious first."""

    @classmethod
    def of(cls, views: Iterable[ViewQuality], findings: Iterable[Finding]) -> Self:
        """Return the quality of a model, its views sorted by index, and its findings the most serious first."""
        return cls(tuple(sorted(views, key=lambda view: view.index)), most_serious_first(findings))

    def with_findings(self, added: Sequence[Finding]) -> Self:
        """Return the quality with further findings, those of equal rank before the others."""
        return replace(self, findings=most_serious_first((*added, *self.findings))) if added else self

    @property
    def verdict(self) -> Verdict:
        """Verdict on the whole model, from the findings (see `recognition.model.trust`)."""
        return model_verdict(self.findings)

    @property
    def doubts(self) -> tuple[Finding, ...]:
        """The findings that are not notes."""
        return tuple(finding for finding in self.findings if finding.severity != "note")
