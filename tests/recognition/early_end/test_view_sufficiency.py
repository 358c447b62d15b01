"""What is doubtful after some views, and the finding on a scan that needed more than the first four."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.early_end.view_sufficiency import MIN_SUFFICIENT_VIEWS, ViewCheck, find_doubts, more_views_finding
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.findings import Finding, finding
from recognition.model.model import PointChainModel
from recognition.model.quality import Quality, ViewQuality
from recognition.parameters import ChainParameters

R = 0.0042
STRING = Chain(
    0, False, R, np.linspace((0, 0, R), (0.2, 0, R), 50), np.full(50, 3e-4), np.full(50, 4), ("free", "free")
)


def crossing(number: int, over_m: float, under_m: float, confidence: float = 1.0) -> Crossing:
    return Crossing(number, np.zeros(3), StrandPoint(0, over_m), StrandPoint(0, under_m), 2 * R, 1.0, 1, confidence)


def model(
    *findings: Finding, chains: tuple[Chain, ...] = (STRING,), crossings: tuple[Crossing, ...] = (), used: int = 4
) -> PointChainModel:
    views = tuple(ViewQuality(k, k < used, None if k < used else "it shows nothing", 1000) for k in range(4))
    parameters = ChainParameters.for_radius(R)
    return PointChainModel("graph", parameters, chains=chains, crossings=crossings, quality=Quality(views, findings))


def test_a_clear_model_that_stayed_the_same_has_no_doubt() -> None:
    note = finding("view-missing", "view 6 is missing: not reachable", view=6)
    now = model(note, crossings=(crossing(0, 0.05, 0.15),))
    assert find_doubts(now, model(crossings=(crossing(3, 0.051, 0.149),))) == ()


@pytest.mark.parametrize(
    ("now", "doubt"),
    [
        (model(chains=()), "no string was found"),
        (model(used=3), "only 3 views can be used"),
        (model(finding("table-not-covered", "5 % of the table is not covered")), "5 % of the table is not covered"),
        (model(finding("sharp-bend", "it bends by 2 rad", chains=[0])), "it bends by 2 rad"),
        (model(chains=(replace(STRING, ends=("free", "unobserved")),)), "the last end of chain 0 was not observed"),
        (model(crossings=(crossing(0, 0.05, 0.15, 0.98),)), "the confidence of crossing 0 is 0.98"),
        (model(crossings=(crossing(0, 0.05, 0.15),)), "the model of fewer views has another topology"),
        (model(chains=(replace(STRING, closed=True),)), "the model of fewer views has another topology"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_doubt_is_named(now: PointChainModel, doubt: str) -> None:
    assert doubt in find_doubts(now, model())


def test_an_end_at_the_border_of_the_workspace_is_no_doubt() -> None:
    """Other views of the same workspace show no more of it."""
    chains = (replace(STRING, ends=("unobserved", "unobserved")),)
    at_border = finding("end-at-border", "it is at the border", chains=[0], end="first")
    assert find_doubts(model(at_border, chains=chains), model()) == ("the last end of chain 0 was not observed",)
    unseen = finding("end-unobserved", "it was not observed", chains=[0], end="last")
    assert find_doubts(model(at_border, unseen, chains=chains), model()) == ("it was not observed",)


def test_a_crossing_whose_strands_changed_places_is_another_topology() -> None:
    before, now = model(crossings=(crossing(0, 0.05, 0.15),)), model(crossings=(crossing(0, 0.15, 0.05),))
    assert find_doubts(now, before) == ("the model of fewer views has another topology",)


def test_a_first_model_is_not_certain() -> None:
    assert find_doubts(model(), None) == ("there is no model of fewer views",)


def test_an_unobserved_end_with_a_finding_is_named_once() -> None:
    found = finding("end-unobserved", "the end at (0.2, 0, 0) is hidden", chains=[0], end="last")
    now = model(found, chains=(replace(STRING, ends=("free", "unobserved")),))
    assert find_doubts(now, model()) == (found.message,)


def test_three_views_never_suffice() -> None:
    assert not ViewCheck(MIN_SUFFICIENT_VIEWS - 1, ()).suffices
    assert ViewCheck(MIN_SUFFICIENT_VIEWS, ()).suffices
    assert not ViewCheck(MIN_SUFFICIENT_VIEWS, ("a doubt",)).suffices


def test_the_finding_says_what_was_doubtful_after_each_view() -> None:
    assert more_views_finding([]) is None
    found = more_views_finding([ViewCheck(4, ("first", "second", "third", "fourth", "fifth")), ViewCheck(5, ("last",))])
    assert found is not None
    assert found.message == (
        "more than 4 views were needed; after 4 views: first; second; third; 2 more doubts; after 5 views: last"
    )
    assert (found.code, found.severity, found.value, found.limit) == ("more-views-needed", "note", 5, 4)


def test_a_check_that_came_too_late_is_no_reason() -> None:
    """The arm does not wait without end for a check, and may have gone on although the views suffice."""
    assert more_views_finding([ViewCheck(4, ())]) is None
