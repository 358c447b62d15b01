"""The JSON document of a scan."""

from dataclasses import replace
from datetime import timedelta

import pytest

from recognition.request import RecognitionRequest
from service.api.schemas.scan_resource import scan_resource
from service.clock import format_utc, utc_now
from service.jobs.submission import NOBODY, new_scan
from service.storage.rows import ViewRow

EXPECTED = {"expected_to_model": 9.0, "expected_to_views": [2.0, 4.0, 6.0, 8.0]}


def remaining_s(elapsed_s: float, view_s: float, views: int) -> float:
    """Return the remaining time of a scan of four views that began `elapsed_s` ago; `view_s` is the time of a view."""
    started = format_utc(utc_now() - timedelta(seconds=elapsed_s))
    scan = new_scan("live", RecognitionRequest(), NOBODY)
    row = replace(scan, state="scanning", started_at=started, timing=EXPECTED)
    rows = [
        ViewRow("x", k, "recorded", None, started, move_s=view_s - 0.5, settle_s=0.2, exposure_s=0.3)
        for k in range(views)
    ]
    remaining = scan_resource(row, [*rows, ViewRow("x", views, "moving", None, started)]).progress.remaining_s
    assert remaining is not None
    return remaining


@pytest.mark.parametrize(
    ("elapsed_s", "view_s", "views", "remaining"),
    [
        (1.0, 2.0, 0, 8.0),  # no view yet: as planned
        (4.5, 2.0, 2, 4.5),  # as planned
        (4.0, 4.0, 1, 8.6),  # one view took twice as long: the remaining 7 s take a fifth longer
        (12.0, 4.0, 3, 5.0),  # three did: the remaining 3 s take two thirds longer
        (3.0, 1.0, 2, 2.9),  # faster so far
        (20.0, 4.0, 2, 0.0),  # late even so
    ],
)
def test_the_remaining_time_follows_the_pace_so_far(
    elapsed_s: float, view_s: float, views: int, remaining: float
) -> None:
    assert remaining_s(elapsed_s, view_s, views) == pytest.approx(remaining, abs=0.3)  # the duration of the test
