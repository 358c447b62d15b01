"""The number of viewpoints, as a configuration, a variable or a request gives it."""

import pytest
from pydantic import ValidationError

from cell.config.cell_config import CellSettings, ScanSettings
from cell.config.scan_views import parse_views


@pytest.mark.parametrize(("value", "views"), [(1, 1), (32, 32), (8.0, 8), ("8", 8), ("auto", "auto")])
def test_numbers_and_auto_are_accepted(value: object, views: object) -> None:
    assert parse_views(value) == views


@pytest.mark.parametrize(
    "value", [0, 33, 8.5, True, "", "Auto", "-8", "8.0", "٨", "9" * 5000, None, [8], float("nan"), float("inf")]
)
def test_other_values_are_refused(value: object) -> None:
    with pytest.raises(ValueError, match='a whole number from 1 to 32 or "auto" is needed'):
        parse_views(value)


def test_a_scan_of_one_viewpoint_needs_one_view() -> None:
    assert CellSettings().for_views(1).scan.min_views == 1
    assert ScanSettings(views=1, min_views=1).viewpoints == 1
    with pytest.raises(ValidationError, match="greater than or equal to 1"):
        ScanSettings(min_views=0)


def test_auto_plans_eight_viewpoints() -> None:
    scan = CellSettings().for_views("auto").scan
    assert (scan.views, scan.viewpoints, scan.min_views) == ("auto", 8, 4)
    with pytest.raises(ValidationError, match="min_views is 9, more than the 8 views"):
        ScanSettings(views="auto", min_views=9)
