"""Which views are used, and why not the others."""

import numpy as np
import pytest

from recognition.errors import InsufficientViewsError, NoDepthError
from recognition.preprocessing.target_cloud import TargetCloud
from recognition.preprocessing.view_selection import MIN_POINTS, select_views


def target(
    view: int, points: int = 500, in_workspace: int = 9000, measured: int = 9000, constant: bool = False
) -> TargetCloud:
    return TargetCloud(view, np.zeros((points, 3)), np.zeros(3), np.eye(4), measured, in_workspace, constant)


def test_views_that_see_a_string_are_used() -> None:
    targets = [target(0), target(1), target(2, points=MIN_POINTS)]
    assert select_views(targets) == (targets, (), None)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (target(1, points=0, in_workspace=0, measured=0), "no pixel has a depth"),
        (target(1, constant=True), "every pixel has the same depth"),
        (target(1, points=0, in_workspace=MIN_POINTS - 1), "nothing measured in the workspace"),
        (target(1, points=MIN_POINTS - 1), "only 49 points are so high above the table as to be of a string (z_t)"),
    ],
    ids=["no depth", "constant", "outside", "too few"],
)
def test_a_bad_view_among_good_ones_is_left_out_with_its_reason(bad: TargetCloud, reason: str) -> None:
    seen, left_out, empty_because = select_views([target(0), bad, target(2)])
    assert [t.view for t in seen] == [0, 2]
    (quality,) = left_out
    assert (quality.index, quality.used, quality.points) == (1, False, len(bad.points))
    assert quality.reason is not None
    assert quality.reason.startswith(reason)
    assert empty_because is None


def test_a_table_without_a_string_is_a_valid_answer() -> None:
    seen, left_out, empty_because = select_views([target(0, points=0), target(1, points=3)])
    assert seen == []
    assert [quality.index for quality in left_out] == [0, 1]
    assert empty_because is not None
    assert empty_because.startswith("no string of this radius in view")


def test_an_empty_table_seen_straight_from_above_is_no_broken_sensor() -> None:
    seen, _, empty_because = select_views([target(0, points=0, constant=True), target(1, points=0)])
    assert seen == []
    assert empty_because is not None
    assert empty_because.startswith("no string of this radius in view")


@pytest.mark.parametrize(("count", "said"), [(0, "0 views given"), (1, "1 view given")])
def test_too_few_views_are_refused(count: int, said: str) -> None:
    with pytest.raises(InsufficientViewsError, match=f"{said}; at least 2 are needed"):
        select_views([target(k) for k in range(count)])


def test_no_depth_anywhere_is_refused_and_says_what_was_seen() -> None:
    blind = [target(0, 0, 0, 0), target(1, 500, 9000, 9000, constant=True), target(2, 0, 10)]
    with pytest.raises(NoDepthError, match="no view measured anything") as caught:
        select_views(blind)
    for said in ("view 0: no pixel has a depth", "view 1: every pixel", "view 2: nothing measured in the workspace"):
        assert said in str(caught.value)


def test_one_view_that_looks_at_the_workspace_is_too_few() -> None:
    with pytest.raises(InsufficientViewsError, match="only view 4 measured anything in the workspace"):
        select_views([target(3, 0, 0, 0), target(4)])


def test_a_string_in_one_view_alone_is_refused() -> None:
    with pytest.raises(InsufficientViewsError, match="only view 5 sees anything above the table, the other 2 do not"):
        select_views([target(4, points=0), target(5), target(6, points=0)])


def test_the_slugs_tell_the_reasons_apart() -> None:
    assert (InsufficientViewsError.slug, NoDepthError.slug) == ("insufficient-views", "no-depth")
