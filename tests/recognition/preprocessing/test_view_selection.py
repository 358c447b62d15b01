"""Selection of views, and the reasons for exclusion."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.errors import DepthNoiseError, InsufficientViewsError, NoDepthError, TooCrowdedError
from recognition.preprocessing.table_scatter import TableScatter
from recognition.preprocessing.target_cloud import TargetCloud
from recognition.preprocessing.view_selection import MIN_POINTS, select_views


def target(
    view: int, points: int = 500, in_workspace: int = 9000, measured: int = 9000, constant: bool = False
) -> TargetCloud:
    return TargetCloud(view, np.zeros((points, 3)), np.zeros(3), np.eye(4), measured, in_workspace, constant)


def test_views_that_see_a_string_are_used() -> None:
    targets = [target(0), target(1), target(2, points=MIN_POINTS)]
    selection = select_views(targets)
    assert (selection.used, selection.excluded, selection.no_string_reason) == (targets, (), None)


@pytest.mark.parametrize(
    ("bad", "code", "reason"),
    [
        (target(1, points=0, in_workspace=0, measured=0), "view-without-depth", "no pixel has a depth"),
        (target(1, constant=True), "view-stuck", "every pixel has the same depth"),
        (
            target(1, points=0, in_workspace=MIN_POINTS - 1),
            "view-outside-workspace",
            "nothing measured in the workspace",
        ),
        (
            target(1, points=MIN_POINTS - 1),
            "view-without-string",
            "only 49 points are higher above the table than the threshold z_t",
        ),
    ],
    ids=["no depth", "constant", "outside", "too few"],
)
def test_a_bad_view_among_good_ones_is_excluded_with_its_reason(bad: TargetCloud, code: str, reason: str) -> None:
    selection = select_views([target(0), bad, target(2)])
    assert [t.view for t in selection.used] == [0, 2]
    (quality,) = selection.excluded
    assert (quality.index, quality.used, quality.points, quality.code) == (1, False, len(bad.points), code)
    assert quality.reason is not None
    assert quality.reason.startswith(reason)
    assert selection.no_string_reason is None


def test_a_table_without_a_string_is_a_valid_answer() -> None:
    selection = select_views([target(0, points=0), target(1, points=3)])
    assert selection.used == ()
    assert [quality.index for quality in selection.excluded] == [0, 1]
    assert selection.no_string_reason is not None
    assert selection.no_string_reason.startswith("no string of this radius in view")


def test_an_empty_table_seen_from_straight_above_is_no_stuck_sensor() -> None:
    selection = select_views([target(0, points=0, constant=True), target(1, points=0)])
    assert selection.used == ()
    assert selection.no_string_reason is not None
    assert selection.no_string_reason.startswith("no string of this radius in view")


def test_no_view_is_an_error() -> None:
    with pytest.raises(InsufficientViewsError, match="no view was given; at least one is needed"):
        select_views([])


def test_one_view_is_enough() -> None:
    selection = select_views([target(3)])
    assert ([used.view for used in selection.used], selection.excluded) == ([3], ())
    assert selection.no_string_reason is None


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (target(0, 0, 0, 0), "view 0: no pixel has a depth"),
        (target(0, 500, 9000, 9000, constant=True), "view 0: every pixel"),
        (target(0, 0, 10), "view 0: nothing measured in the workspace"),
    ],
)
def test_a_single_bad_view_is_an_error_with_its_reason(bad: TargetCloud, reason: str) -> None:
    with pytest.raises(NoDepthError, match=reason):
        select_views([bad])


def test_a_single_view_of_a_table_without_a_string_is_a_valid_answer() -> None:
    selection = select_views([target(0, points=0)])
    assert selection.used == ()
    assert (selection.no_string_reason or "").startswith("no string of this radius in view")


def test_no_depth_anywhere_is_an_error_with_the_reason_of_each_view() -> None:
    blind = [target(0, 0, 0, 0), target(1, 500, 9000, 9000, constant=True), target(2, 0, 10)]
    with pytest.raises(NoDepthError, match="no view measured anything") as caught:
        select_views(blind)
    for reason in ("view 0: no pixel has a depth", "view 1: every pixel", "view 2: nothing measured in the workspace"):
        assert reason in str(caught.value)


def test_the_only_view_that_measured_the_workspace_is_used() -> None:
    selection = select_views([target(3, 0, 0, 0), target(4), target(5, 0, 10)])
    assert [used.view for used in selection.used] == [4]
    assert [quality.code for quality in selection.excluded] == ["view-without-depth", "view-outside-workspace"]


def test_a_string_in_only_one_view_of_the_table_is_an_error() -> None:
    with pytest.raises(InsufficientViewsError, match="only view 5 sees anything above the table, the other 2 that"):
        select_views([target(4, points=0), target(5), target(6, points=0), target(7, 0, 0, 0)])


def test_the_errors_have_different_slugs() -> None:
    assert (InsufficientViewsError.slug, NoDepthError.slug) == ("insufficient-views", "no-depth")


def noisy(view: int) -> TargetCloud:
    return replace(target(view), scatter=TableScatter(0.0023, 0.001), n_below=400, threshold_m=0.005)


def test_few_noisy_views_are_excluded_and_many_are_refused() -> None:
    selection = select_views([target(0), noisy(1), target(2)])
    assert [view.view for view in selection.used] == [0, 2]
    assert [(view.index, view.code) for view in selection.excluded] == [(1, "view-noisy")]
    with pytest.raises(
        DepthNoiseError, match=r"scatters by 2.3 mm .*threshold of 5.0 mm are noise.*limit 50%"
    ) as caught:
        select_views([target(0), noisy(1), noisy(2)])
    assert "Move the viewpoints nearer" in str(caught.value)


def test_a_noisy_view_says_nothing_about_the_string_of_a_single_view() -> None:
    """Unlike a view of a bare table, which contradicts it."""
    assert [view.view for view in select_views([target(0), noisy(1)]).used] == [0]


def test_the_message_on_crowded_views_speaks_of_other_views_only_if_there_are_any() -> None:
    crowded = [target(view, points=8900) for view in (0, 1)]
    with pytest.raises(
        TooCrowdedError, match=r"99% of what view 0 measured .*, and most other views show the same: check"
    ):
        select_views(crowded)
    with pytest.raises(TooCrowdedError, match="99% of what view 0 measured in the workspace is above the table: check"):
        select_views(crowded[:1])
