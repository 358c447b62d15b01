"""Selection of the views that recognition can use, with a reason for each excluded view."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from recognition.errors import DepthNoiseError, InsufficientViewsError, NoDepthError, TooCrowdedError
from recognition.model.quality import ExclusionReason, ViewQuality
from recognition.preprocessing.table_scatter import NOISE_ADVICE
from recognition.preprocessing.target_cloud import TargetCloud

CROWDED_SHARE = 0.8
"""Maximum share of the points of a view that are above the table. With a larger share, the table height is too low."""
MAX_NOISE_SHARE = 0.5
"""Maximum share of noise in the points above the table. Noise of the table gives as many points below it."""
MIN_POINTS = 50
"""Minimum number of points above the height threshold, and of measured points in the workspace. Fewer are noise."""
NO_STRING_REASON = (
    "no string of this radius in view: nothing in the workspace is higher above the table than the threshold z_t"
)
"""Why a scene has no string if no view shows one."""


@dataclass(frozen=True, eq=False)
class ViewSelection:
    """Views that recognition uses, and views that it excludes."""

    used: Sequence[TargetCloud]
    """Views that show a string; empty if no view shows a string."""
    excluded: tuple[ViewQuality, ...]
    """All other views, each with the reason."""
    no_string_reason: str | None
    """Why the scene has no string; None if a string is visible."""


def select_views(targets: Sequence[TargetCloud]) -> ViewSelection:
    """Select the views that show a string.

    Args:
        targets: Target clouds of all views.

    Returns:
        The used views, the excluded views, and the reason if there is no string.

    Raises:
        InsufficientViewsError: No view was given, or only one view shows a string and others show a bare table.
        NoDepthError: No view measured anything in the workspace.
        DepthNoiseError: In most views, most points above the table are noise of the table.
        TooCrowdedError: In most views, nearly all points are above the table.
    """
    if not targets:
        raise InsufficientViewsError("no view was given; at least one is needed")
    reasons = {target.view: exclusion_reason(target) for target in targets}
    measuring = [target for target in targets if target.n_in_workspace >= MIN_POINTS and not _is_sensor_stuck(target)]
    if not measuring:
        raise NoDepthError(_no_depth_message(reasons))
    used = [target for target in targets if reasons[target.view] is None]
    noisy = [target for target in measuring if _is_noisy(target)]
    if len(noisy) > len(measuring) / 2:
        raise DepthNoiseError(_noise_message(noisy))
    crowded = [target for target in used if len(target.points) > CROWDED_SHARE * target.n_in_workspace]
    if len(crowded) > len(used) / 2:
        raise TooCrowdedError(_crowded_message(crowded[0], len(used)))
    n_bare = len(measuring) - len(used) - len(noisy)
    if len(used) == 1 and n_bare:
        raise InsufficientViewsError(
            f"only view {used[0].view} sees anything above the table, the other {n_bare} that measured the table do "
            "not: the views do not agree, so no model is made"
        )
    excluded = _excluded_qualities(targets, reasons)
    if not used:
        return ViewSelection((), excluded, NO_STRING_REASON)
    return ViewSelection(used, excluded, None)


def exclusion_reason(target: TargetCloud) -> ExclusionReason | None:
    """Return the reason why a view cannot be used, independent of the other views.

    Args:
        target: Target cloud of the view.

    Returns:
        The reason, or None if the view can be used.
    """
    if target.n_measured == 0:
        return ExclusionReason("view-without-depth", "no pixel has a depth")
    if target.n_in_workspace < MIN_POINTS:
        return ExclusionReason("view-outside-workspace", "nothing measured in the workspace")
    if _is_sensor_stuck(target):
        message = "every pixel has the same depth, and it is not the depth of the table: check the camera"
        return ExclusionReason("view-stuck", message)
    if len(target.points) < MIN_POINTS:
        message = f"only {len(target.points)} points are higher above the table than the threshold z_t"
        return ExclusionReason("view-without-string", message)
    if _is_noisy(target):
        message = (
            f"the depth of the table scatters by {target.scatter.pixel_m * 1000:.1f} mm, so that most points above the "
            "threshold z_t are noise"
        )
        return ExclusionReason("view-noisy", message)
    return None


def _excluded_qualities(
    targets: Sequence[TargetCloud], reasons: Mapping[int, ExclusionReason | None]
) -> tuple[ViewQuality, ...]:
    """Return the quality of each excluded view, with its reason."""
    qualities = []
    for target in targets:
        reason = reasons[target.view]
        if reason is not None:
            qualities.append(ViewQuality(target.view, False, reason.message, len(target.points), code=reason.code))
    return tuple(qualities)


def _no_depth_message(reasons: Mapping[int, ExclusionReason | None]) -> str:
    """Return the message of a `NoDepthError`, from the reasons by view index."""
    details = "; ".join(f"view {view}: {reason.message}" for view, reason in reasons.items() if reason is not None)
    return (
        f"no view measured anything in the workspace ({details}). Check the camera, the table height and the workspace"
    )


def _crowded_message(crowded: TargetCloud, n_used: int) -> str:
    """Return the message of a `TooCrowdedError`, from a crowded view and the number of used views."""
    share = len(crowded.points) / crowded.n_in_workspace
    others = ", and most other views show the same" if n_used > 1 else ""
    return (
        f"{share:.0%} of what view {crowded.view} measured in the workspace is above the table{others}: check the "
        "table height and the workspace"
    )


def _noise_message(noisy: Sequence[TargetCloud]) -> str:
    """Return the message of a `DepthNoiseError`, from the views with noise."""
    scatter_mm = 1000 * float(np.median([target.scatter.pixel_m for target in noisy]))
    share = float(np.median([min(target.n_below / len(target.points), 1.0) for target in noisy]))
    return (
        f"the depth of the table scatters by {scatter_mm:.1f} mm (one sigma, median of {len(noisy)} views). "
        f"{share:.0%} of the points above the height threshold of {1000 * noisy[0].threshold_m:.1f} mm are noise, "
        f"because as many are below the table (limit {MAX_NOISE_SHARE:.0%}). {NOISE_ADVICE}"
    )


def _is_noisy(target: TargetCloud) -> bool:
    """Return whether most points above the threshold are noise of the table."""
    return len(target.points) >= MIN_POINTS and target.n_below > MAX_NOISE_SHARE * len(target.points)


def _is_sensor_stuck(target: TargetCloud) -> bool:
    """Return whether all pixels have the same depth, except for an empty table seen from straight above."""
    return target.constant_depth and len(target.points) >= MIN_POINTS
