"""Whether the views of a scan suffice, so that it can end before its last viewpoint.

Views of one ring show the topology as well as those of two rings. Further views mainly average the pose errors. Two
views never suffice, because a model of two views may be wrong without a finding.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import get_args

from recognition.model.chains import MIN_CERTAIN_CONFIDENCE
from recognition.model.findings import Finding, Which, finding
from recognition.model.model import PointChainModel

MIN_SUFFICIENT_VIEWS = 4
"""Smallest number of views that can suffice."""
FIRST_CHECK = MIN_SUFFICIENT_VIEWS - 1
"""Number of views that are recognised first, because a model is compared with that of fewer views."""
MIN_CONFIDENCE = 0.99
"""Smallest confidence of a crossing that needs no further view."""
MAX_DOUBTS = 3
"""Number of doubts that the finding names for each number of views."""


@dataclass(frozen=True)
class ViewCheck:
    """What is doubtful after some of the views of a scan."""

    views: int
    """Number of views so far."""
    doubts: tuple[str, ...]
    """What is doubtful after these views."""

    @property
    def suffices(self) -> bool:
        """Whether no further view is needed."""
        return self.views >= MIN_SUFFICIENT_VIEWS and not self.doubts


@dataclass(frozen=True)
class ViewChecks:
    """Checks of the views so far, for a caller that decides whether further views are needed."""

    on_check: Callable[[ViewCheck], None]
    """Receives what is doubtful, whenever the views so far have been recognised."""
    next_is_here: Callable[[], bool] = lambda: False
    """Whether the view after the latest one is already here. The views before it are not checked then."""


def find_doubts(model: PointChainModel, before: PointChainModel | None) -> tuple[str, ...]:
    """Return what is doubtful about a model and may be certain with another view.

    There is no doubt if the model has a chain, at least `MIN_SUFFICIENT_VIEWS` used views, no finding above a note, no
    unobserved end, no crossing below `MIN_CONFIDENCE`, and the topology of the model before. An end at the border of
    the workspace is no doubt, because other views show no more of it.

    Args:
        model: Model of the views so far.
        before: Model of the same views without the last one or more, or None if there is none.
    """
    doubts = [found.message for found in model.quality.findings if found.severity != "note"]
    used = sum(view.used for view in model.quality.views)
    if not model.chains:
        doubts.append("no string was found")
    elif used < MIN_SUFFICIENT_VIEWS:
        doubts.append(f"only {used} view{'s' * (used != 1)} can be used")
    # A finding `end-unobserved` is a doubt of its own.
    on_ends = [found for found in model.quality.findings if found.code in ("end-unobserved", "end-at-border")]
    for chain in model.chains:
        explained = [found.end for found in on_ends if chain.id in found.chains]
        for which, kind in zip(get_args(Which), chain.ends, strict=True):
            if kind == "unobserved" and which not in explained:
                doubts.append(f"the {which} end of chain {chain.id} was not observed")
    doubts += [
        f"the confidence of crossing {crossing.id} is {crossing.confidence:.2f}"
        for crossing in model.crossings
        if MIN_CERTAIN_CONFIDENCE <= crossing.confidence < MIN_CONFIDENCE  # a lower one has a finding
    ]
    if before is None:
        doubts.append("there is no model of fewer views")
    elif _topology(before) != _topology(model):
        doubts.append("the model of fewer views has another topology")
    return tuple(doubts)


def more_views_finding(checks: Sequence[ViewCheck]) -> Finding | None:
    """Return the note on why a scan needed more than `MIN_SUFFICIENT_VIEWS` views, or None if it did not.

    Args:
        checks: Checks of `MIN_SUFFICIENT_VIEWS` views and more after which the scan went on.
    """
    doubtful = [check for check in checks if not check.suffices]
    if not doubtful:
        return None
    parts = [f"after {check.views} views: {'; '.join(_shortened(check.doubts))}" for check in doubtful]
    message = f"more than {MIN_SUFFICIENT_VIEWS} views were needed; {'; '.join(parts)}"
    return finding("more-views-needed", message, value=doubtful[-1].views, limit=MIN_SUFFICIENT_VIEWS)


def _shortened(doubts: Sequence[str]) -> list[str]:
    named = list(doubts[:MAX_DOUBTS])
    if len(doubts) > MAX_DOUBTS:
        named.append(f"{len(doubts) - MAX_DOUBTS} more doubts")
    return named


def _topology(model: PointChainModel) -> list[tuple[bool, list[tuple[int, str, int]]]]:
    """Return the crossings along each chain, numbered in the order in which the chains reach them."""
    numbers: dict[int, int] = {}
    topology = []
    for chain, passes in zip(model.chains, model.gauss_code(), strict=True):
        along = [(numbers.setdefault(crossing, len(numbers)), role, sign) for crossing, role, sign in passes]
        topology.append((chain.closed, along))
    return topology
