"""Recognition after each view, to find out when the views of a scan suffice."""

from collections.abc import Callable, Iterable, Sequence

from recognition.early_end.view_sufficiency import (
    FIRST_CHECK,
    MIN_SUFFICIENT_VIEWS,
    ViewCheck,
    find_doubts,
    more_views_finding,
)
from recognition.errors import RecognitionError
from recognition.preprocessing.target_cloud import DepthView
from recognition.result import Recognition

RecogniseSome = Callable[[Sequence[DepthView], Recognition | None], Recognition]
"""Recognises some views, with the recognition of the first of them, if there is one, as `earlier` of `recognise`."""


def recognise_after_each_view(
    views: Iterable[DepthView],
    recognise_some: RecogniseSome,
    on_check: Callable[[ViewCheck], None],
    next_is_here: Callable[[], bool] = lambda: False,
) -> Recognition:
    """Recognise the views so far when a view arrives, from the third view on, and return the last recognition.

    After the third view, they are not recognised if the next view is already here, so that no time is lost after the
    last view. If more than `MIN_SUFFICIENT_VIEWS` views were needed, the model has a finding that says why.

    Args:
        views: Depth images with their camera poses, one by one. The caller ends them when a check suffices.
        recognise_some: Recognises the views so far.
        on_check: Receives what is doubtful, whenever the views so far have been recognised.
        next_is_here: Whether the view after the latest one is already here.

    Raises:
        RecognitionError: As `recognise_some` raises it for all views.
    """
    taken: list[DepthView] = []
    checks: list[ViewCheck] = []
    latest: Recognition | None = None
    before: Recognition | None = None
    for view in views:
        taken.append(view)
        if len(taken) < FIRST_CHECK or (len(taken) > FIRST_CHECK and next_is_here()):
            continue
        before = latest
        latest = None
        try:
            latest = recognise_some(taken, before)
            doubts = find_doubts(latest.model, before and before.model)
        except RecognitionError as error:
            doubts = (str(error),)
        checks.append(ViewCheck(len(taken), doubts))
        on_check(checks[-1])
    if latest is None or checks[-1].views < len(taken):
        latest = recognise_some(taken, latest or before)
    needed = more_views_finding([check for check in checks if MIN_SUFFICIENT_VIEWS <= check.views < len(taken)])
    return latest if needed is None else latest.with_findings([needed])
