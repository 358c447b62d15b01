"""Comparison of scans that take views as needed with scans of eight views."""

from dataclasses import replace

import pytest

from cell.simulation.cases import make_case
from service.benchmark.views import (
    VIEWS_COLUMNS,
    ViewsCase,
    ViewsResult,
    ViewsSummary,
    run_views_case,
    summarise_views,
    views_row,
)


@pytest.fixture(scope="module")
def case() -> ViewsCase:
    """One scene of tier `paper`."""
    result = run_views_case(("paper", 0), "ideal")
    assert result is not None
    return result


def test_both_scans_of_a_scene_are_scored(case: ViewsCase) -> None:
    assert (case.tier, case.seed, case.views) == ("paper", 0, 4)
    for result in (case.auto, case.eight):
        assert result.is_right
        assert not result.is_silently_wrong
        assert result.verdict == "accept"
        assert result.score is not None
        # The poses have errors of half a millimetre.
        assert result.score.mean_m is not None
        assert 0.0 < result.score.mean_m < 0.001
    assert case.auto.score != case.eight.score


def test_a_string_outside_the_workspace_is_left_out() -> None:
    """The default cell sees 0.36 m, which is less than some tangles of tier `photo` take."""
    largest = max(abs(curve[:, :2]).max() for curve in make_case("photo", 0, "ideal").scene.curves)
    assert largest > 0.18
    assert run_views_case(("photo", 0), "ideal") is None


def test_a_summary_counts_the_scenes_in_the_workspace(case: ViewsCase) -> None:
    score = case.auto.score
    assert score is not None
    nearer = replace(score, mean_m=0.0002, end_m=0.0005)
    wrong = replace(score, topology=False, mean_m=0.0004, end_m=None)
    refused = ViewsResult(None, None)
    cases = [
        replace(case, auto=ViewsResult(nearer, "accept"), eight=ViewsResult(nearer, "accept")),
        replace(case, views=8, auto=ViewsResult(wrong, "accept"), eight=ViewsResult(wrong, "review")),
        replace(case, views=6, auto=refused, eight=refused),
        None,
    ]
    summary = summarise_views(cases)
    assert summary == ViewsSummary(
        scenes=3,
        four_views=1,
        mean_views=6.0,
        auto_right=1,
        eight_right=1,
        auto_silently_wrong=1,
        eight_silently_wrong=0,
        auto_mean_mm=0.3,
        eight_mean_mm=0.3,
        auto_end_mm=0.5,
        eight_end_mm=0.5,
    )
    row = views_row("paper", summary)
    assert row == "| paper | 3 | 33% | 6.0 | 1 | 1 | 1 | 0 | 0.30 mm | 0.30 mm | 0.50 mm | 0.50 mm |"
    assert row.count("|") == len(VIEWS_COLUMNS) + 1


def test_a_tier_without_a_scene_in_the_workspace_has_no_figures() -> None:
    assert views_row("photo", summarise_views([None])) == "| photo | 0 | - | - | 0 | 0 | 0 | 0 | - | - | - | - |"
