"""The example planners scan again for the findings for which the table of codes says so."""

import re
from pathlib import Path

import pytest

from recognition.model.finding_types import FINDING_TYPES

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
CODES = re.compile(r'^(?:const )?MORE_DATA_HELPS\b[^"]*((?:"[\w-]+",?\s*)+)', re.MULTILINE)
"""The strings in the set of a planner, which has no other access to the table."""


@pytest.mark.parametrize("planner", ["planner.py", "planner.ts"])
def test_a_planner_scans_again_if_the_decision_is_to_scan_again(planner: str) -> None:
    found = CODES.search((EXAMPLES / planner).read_text())
    assert found is not None
    codes = re.findall(r'"([\w-]+)"', found[1])
    assert sorted(codes) == sorted(code for code, kind in FINDING_TYPES.items() if kind.decision == "scan again")
