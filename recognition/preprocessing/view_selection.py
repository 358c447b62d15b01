"""Which views recognition can use, and why not the others."""

from collections.abc import Sequence

from recognition.errors import InsufficientViewsError, NoDepthError, TooCrowdedError
from recognition.model.model import ViewQuality
from recognition.preprocessing.target_cloud import TargetCloud

MIN_VIEWS = 2
"""One view sees one side of a string and nothing under a crossing; two are the least that can be merged."""
CROWDED_SHARE = 0.8
"""A larger share of a view's points above the table, and it is the table itself that stands too high."""
MIN_POINTS = 50
"""Fewer points of string height than this are noise."""


def select_views(
    targets: Sequence[TargetCloud],
) -> tuple[list[TargetCloud], tuple[ViewQuality, ...], str | None]:
    """The views that see a string, the others with the reason, and why there is no string when there is none.

    Raises:
        InsufficientViewsError: fewer than two views were given, fewer than two saw the workspace, or the string
            is in one alone.
        NoDepthError: no view measured anything in the workspace.
        TooCrowdedError: most views see little else than points above the table.
    """
    if len(targets) < MIN_VIEWS:
        raise InsufficientViewsError(
            f"{len(targets)} view{'s' * (len(targets) != 1)} given; at least {MIN_VIEWS} are needed"
        )
    reasons = {target.view: exclusion_reason(target) for target in targets}
    left_out = tuple(
        ViewQuality(target.view, False, reason, len(target.points))
        for target in targets
        if (reason := reasons[target.view]) is not None
    )
    looking = [target for target in targets if target.in_workspace >= MIN_POINTS and not _broken(target)]
    if not looking:
        said = "; ".join(f"view {view}: {reason}" for view, reason in reasons.items())
        raise NoDepthError(
            f"no view measured anything in the workspace ({said}). Check the camera, the table height and the workspace"
        )
    if len(looking) < MIN_VIEWS:
        raise InsufficientViewsError(
            f"only view {looking[0].view} measured anything in the workspace; at least {MIN_VIEWS} are needed"
        )
    seen = [target for target in targets if reasons[target.view] is None]
    crowded = [target for target in seen if len(target.points) > CROWDED_SHARE * target.in_workspace]
    if len(crowded) > len(seen) / 2:
        share = len(crowded[0].points) / crowded[0].in_workspace
        raise TooCrowdedError(
            f"{share:.0%} of what view {crowded[0].view} measured in the workspace is above the table, and it is not "
            "alone: check the table's height and the workspace"
        )
    if len(seen) >= MIN_VIEWS:
        return seen, left_out, None
    if seen:
        raise InsufficientViewsError(
            f"only view {seen[0].view} sees anything above the table, the other {len(targets) - 1} do not: "
            "the views do not agree, so no model is made"
        )
    return [], left_out, "no string of this radius in view: nothing in the workspace is as high above the table as z_t"


def exclusion_reason(target: TargetCloud) -> str | None:
    """Why this view cannot be used whatever the others show, or None."""
    if target.measured == 0:
        return "no pixel has a depth"
    if target.in_workspace < MIN_POINTS:
        return "nothing measured in the workspace"
    if _broken(target):
        return "every pixel has the same depth, and not the table's: not a picture of anything"
    if len(target.points) < MIN_POINTS:
        return f"only {len(target.points)} points are so high above the table as to be of a string (z_t)"
    return None


def _broken(target: TargetCloud) -> bool:
    """One depth all over, as from a stuck sensor. An empty table seen straight from above is no such thing."""
    return target.constant and len(target.points) >= MIN_POINTS
