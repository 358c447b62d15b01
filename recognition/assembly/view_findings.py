"""Findings on excluded views, and on a calibration that all views contradict."""

from collections.abc import Sequence
from dataclasses import replace

from recognition.model.chains import Chain
from recognition.model.findings import Finding, finding
from recognition.model.quality import ViewQuality
from recognition.registration.registration import Registration


def view_findings(views: Sequence[ViewQuality], last_view: int, chains: Sequence[Chain]) -> list[Finding]:
    """Return a note on each excluded view, and a doubt if the scene may have changed before the last view.

    A view that contradicts the others had a wrong pose, or something moved. If later views agree with earlier ones,
    nothing moved for good. If the last view contradicts, the model may show how the scene was before.

    Args:
        views: Quality of all views.
        last_view: Index of the view that was captured last.
        chains: Chains of the model. Without chains, a view that shows only the table gives no note.
    """
    findings = []
    for view in views:
        if view.code is None or (view.code == "view-without-string" and not chains):
            continue
        findings.append(finding(view.code, f"view {view.index} was excluded: {view.reason}", view=view.index))
        if view.code == "view-contradicting" and view.index == last_view:
            message = f"view {view.index}, the last one, contradicts the others: something may have moved before it"
            findings.append(finding("scene-changed", message, chains=[chain.id for chain in chains], view=view.index))
    return findings


def drift_findings(registration: Registration, chains: Sequence[Chain]) -> list[Finding]:
    """Return the doubt about the calibration, if there is one. It concerns all chains."""
    drift = registration.hand_eye_drift
    return [] if drift is None else [replace(drift, chains=tuple(chain.id for chain in chains))]
