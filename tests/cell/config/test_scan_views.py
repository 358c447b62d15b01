"""The number of viewpoints, as a configuration, a variable or a request gives it."""

import pytest
from pydantic import ValidationError

from cell.config.cell_config import CellSettings, ScanSettings
from cell.config.scan_views import parse_views


@pytest.mark.parametrize(("value", "views"), [(2, 2), (32, 32), (8.0, 8), ("8", 8), ("auto", "auto")])
def test_numbers_and_auto_are_accepted(value: object, views: object) -> None:
    assert parse_views(value) == views


@pytest.mark.parametrize(
    "value", [1, 33, 8.5, True, "", "Auto", "-8", "8.0", "٨", "9" * 5000, None, [8], float("nan"), float("inf")]
)
def test_other_values_are_refused(value: object) -> None:
    with pytest.raises(ValueError, match='a whole number from 2 to 32 or "auto" is needed'):
        parse_views(value)


def test_auto_plans_eight_viewpoints() -> None:
    scan = CellSettings().for_views("auto").scan
    assert (scan.views, scan.viewpoints, scan.min_views) == ("auto", 8, 4)
    with pytest.raises(ValidationError, match="min_views is 9, more than the 8 views"):
        ScanSettings(views="auto", min_views=9)
