"""Findings on excluded views, on a single view, on camera and depth noise, and on a contradicted calibration."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recognition.depth_correction.depth_warp import MIN_WARP_M, DepthWarp
from recognition.model.chains import Chain
from recognition.model.finding_types import FindingCode
from recognition.model.findings import Finding, finding
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.table_scatter import NOISE_ADVICE, THRESHOLD_SIGMAS, max_scatter_m
from recognition.registration.registration import Registration

MAX_LISTED_VIEWS = 3
"""Maximum number of views excluded for one cause with their own notes. With more, one note stands for all of them."""


def view_findings(views: Sequence[ViewQuality], captured: Sequence[int], chains: Sequence[Chain]) -> list[Finding]:
    """Return the notes on excluded views, and a doubt if the scene may have changed during the scan.

    Many views that were excluded for one cause have one note. The reason of each view is in the quality of the views.

    A view that contradicts the others had a wrong pose, or something moved before it. If something moved, all views
    after that contradict the earlier ones. If a view is used that was captured after a contradicting one, the pose was
    wrong.

    Args:
        views: Quality of all views.
        captured: Indices of the views in the order in which they were captured.
        chains: Chains of the model. Without chains, a view that shows only the table gives no note.
    """
    findings = []
    codes: dict[FindingCode, None] = dict.fromkeys(view.code for view in views if view.code is not None)
    for code in codes:
        if code != "view-without-string" or chains:
            findings += _exclusion_findings(code, [view for view in views if view.code == code])
    contradicting = [captured.index(view.index) for view in views if view.code == "view-contradicting"]
    used = [captured.index(view.index) for view in views if view.used]
    if contradicting and used and min(contradicting) > max(used):
        first = captured[min(contradicting)]
        message = f"no view from view {first} on fits the earlier ones: something may have moved before it"
        findings.append(finding("scene-changed", message, chains=[chain.id for chain in chains], view=first))
    return findings


def _exclusion_findings(code: FindingCode, views: Sequence[ViewQuality]) -> list[Finding]:
    """Return a note on each view that was excluded for one cause, or one note on all of them if they are many."""
    if len(views) <= MAX_LISTED_VIEWS:
        return [finding(code, f"view {view.index} was excluded: {view.reason}", view=view.index) for view in views]
    worst = max(views, key=lambda view: view.points)
    numbers = ", ".join(str(view.index) for view in views)
    message = (
        f"{len(views)} views were excluded for one cause ({numbers}), for example view {worst.index}: {worst.reason}"
    )
    return [finding(code, message, view=worst.index)]


def drift_findings(registration: Registration, chains: Sequence[Chain]) -> list[Finding]:
    """Return the doubt about the calibration, if there is one. It concerns all chains."""
    drift = registration.hand_eye_drift
    if drift is None:
        return []
    return [replace(drift, chains=tuple(chain.id for chain in chains))]


def single_view_findings(
    views: Sequence[ViewQuality], given: Sequence[NormalCloud], chains: Sequence[Chain]
) -> list[Finding]:
    """Return a note if only one view is used, and a doubt if this view was not aligned to the table plane.

    No other view can contradict a single one. That alone is no doubt: `sigma_m` contains the whole error of a good
    calibration, and a crossing or an end that one view does not decide has a doubt of its own. The table plane is the
    only evidence that the camera is where the calibration says. Without it, a camera that has moved would go unnoticed.

    Args:
        views: Quality of all views.
        given: Views before registration.
        chains: Chains of the model.
    """
    used = [view.index for view in views if view.used]
    if len(used) != 1:
        return []
    message = (
        f"only view {used[0]} is used: no other view checks its pose, shows whether something moved, or sees what it "
        "hides; the positions depend on the calibration and on the given table"
    )
    findings = [finding("single-view", message, view=used[0])]
    is_aligned = any(not np.array_equal(cloud.T_correction, np.eye(4)) for cloud in given if cloud.view == used[0])
    if not is_aligned:
        message = (
            f"view {used[0]}, the only one, shows too little of the table in the workspace to check its pose: the "
            "camera may have moved; verify the calibration, or choose a view that shows more of the table"
        )
        ids = [chain.id for chain in chains]
        findings.append(finding("single-view-not-aligned", message, chains=ids, view=used[0]))
    return findings


def warp_findings(warp: DepthWarp | None) -> list[Finding]:
    """Return the note on a warp of the camera that was corrected, or none."""
    if warp is None:
        return []
    message = (
        f"all depth images show the table curved in the same way, by {warp.rms_m * 1000:.1f} mm (root mean square): "
        "this error of the camera was corrected"
    )
    return [finding("depth-warp", message, value=warp.rms_m, limit=MIN_WARP_M)]


def noise_findings(registration: Registration, parameters: ChainParameters) -> list[Finding]:
    """Return the doubt about depth noise, if patches of depth differ by the radius, or pixels reach the threshold.

    It concerns the whole model, because noise can also hide a string or look like one.
    """
    patch_m = float(np.median([cloud.scatter.patch_m or 0.0 for cloud in registration.clouds]))
    max_patch_m = max_scatter_m(parameters)
    if patch_m > max_patch_m:
        return [_noise_finding("from patch to patch", patch_m, max_patch_m, parameters.r)]
    pixel_m = float(np.median([cloud.scatter.pixel_m for cloud in registration.clouds]))
    max_pixel_m = parameters.z_t / THRESHOLD_SIGMAS
    if pixel_m > max_pixel_m:
        return [_noise_finding("from pixel to pixel", pixel_m, max_pixel_m, parameters.r)]
    return []


def _noise_finding(kind: str, noise_m: float, limit_m: float, r: float) -> Finding:
    """Return the doubt about depth noise of one kind, which exceeds its limit."""
    message = (
        f"the depth of the table scatters by {noise_m * 1000:.1f} mm {kind} (limit {limit_m * 1000:.1f} mm), "
        f"too much for a string radius of {r * 1000:.1f} mm: the model may be wrong. {NOISE_ADVICE}"
    )
    return finding("depth-noise", message, value=noise_m, limit=limit_m)
