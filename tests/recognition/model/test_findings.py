"""Findings: the table of codes, the values of a finding, the order, and the JSON document."""

import json
from typing import get_args

import numpy as np
import pytest

from recognition.model.document import FindingDocument, finding_json
from recognition.model.finding_types import FINDING_TYPES, Decision, FindingCode, FindingType, Scope, Severity
from recognition.model.findings import SEVERITIES, Finding, finding, most_serious_first

FULL = finding(
    "ends-touching",
    "an end faces another end",
    chains=[0],
    crossing=0,
    end="first",
    s_range_m=(0.0, 1 / 3),
    point=np.array([0.1, -1e-9, 1 / 3]),
    view=0,
    value=0.0,
    limit=2 / 3,
)
"""A finding with all members. Zeros, because a zero is not an absent member."""


def test_the_table_has_every_code_with_a_known_severity_scope_and_decision() -> None:
    assert set(FINDING_TYPES) == set(get_args(FindingCode))
    assert set(SEVERITIES) == set(get_args(Severity)) == {found.severity for found in FINDING_TYPES.values()}
    assert {found.scope for found in FINDING_TYPES.values()} <= set(get_args(Scope))
    assert {found.decision for found in FINDING_TYPES.values()} == set(get_args(Decision))


@pytest.mark.parametrize(("code", "found"), FINDING_TYPES.items())
def test_each_code_says_what_was_found_and_what_to_do(code: str, found: FindingType) -> None:
    assert code == code.lower().strip()
    assert found.meaning.endswith(".")
    assert found.action.endswith(".")
    assert (found.scope == "nothing") == (found.severity == "note"), "only notes block nothing"
    assert (found.decision == "nothing") == (found.severity == "note"), "only notes need no decision"
    assert found.value is None or found.value.strip()


def test_the_codes_are_listed_with_the_most_serious_first() -> None:
    ranks = [SEVERITIES.index(found.severity) for found in FINDING_TYPES.values()]
    assert ranks == sorted(ranks)


@pytest.mark.parametrize("code", get_args(FindingCode))
def test_a_finding_has_the_severity_of_its_code(code: FindingCode) -> None:
    assert finding(code, "message") == Finding(code, FINDING_TYPES[code].severity, "message")


def test_numbers_and_arrays_become_plain_values() -> None:
    found = finding(
        "possible-object",
        "message",
        chains=[3],
        s_range_m=(np.float64(0.1), np.float64(0.2)),
        point=np.array([1.0, 2.0, 3.0]),
        value=np.float64(0.7),
        limit=1,
    )
    assert found.point_m == (1.0, 2.0, 3.0)
    values = [*(found.s_range_m or ()), *(found.point_m or ()), found.value, found.limit]
    assert {type(value) for value in values} == {float}
    json.dumps(finding_json(found), allow_nan=False)


def test_the_most_serious_come_first_then_the_order_of_the_table_then_the_given_order() -> None:
    given = [
        finding("view-stuck", "a note"),
        finding("above-table", "the second doubt"),
        Finding("code-of-a-later-version", "doubt", "an unknown doubt"),
        finding("crossing-undecided", "the first doubt", crossing=1),
        finding("crossing-undecided", "the first doubt", crossing=0),
        finding("sharp-bend", "blocking"),
    ]
    ordered = most_serious_first(given)
    assert [given.index(found) for found in ordered] == [5, 3, 4, 1, 2, 0]


def test_absent_members_are_absent_in_the_document() -> None:
    assert finding_json(finding("view-stuck", "the reason")) == {
        "code": "view-stuck",
        "severity": "note",
        "message": "the reason",
    }


def test_a_member_that_is_zero_is_present_and_numbers_are_rounded_to_a_micrometre() -> None:
    document = finding_json(FULL)
    assert document == {
        "code": "ends-touching",
        "severity": "doubt",
        "message": "an end faces another end",
        "chains": [0],
        "crossing": 0,
        "end": "first",
        "s_range_m": [0.0, 0.333333],
        "point_m": [0.1, 0.0, 0.333333],
        "view": 0,
        "value": 0.0,
        "limit": 0.666667,
    }
    assert "-0.0" not in json.dumps(document)


def test_a_finding_that_was_written_is_read_again() -> None:
    for found in (finding("scene-changed", "the last view", chains=(0, 2), view=7), finding("no-string-found", "none")):
        assert FindingDocument.model_validate(finding_json(found)).to_finding() == found
    again = FindingDocument.model_validate(finding_json(FULL)).to_finding()
    assert finding_json(again) == finding_json(FULL)


def test_a_later_version_may_add_codes_and_members() -> None:
    document = {"code": "new", "severity": "doubt", "message": "m", "chains": [1], "colour": "red"}
    assert FindingDocument.model_validate(document).to_finding() == Finding("new", "doubt", "m", (1,))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_number_that_is_not_finite_is_not_written(value: float) -> None:
    for found in (
        finding("above-table", "message", value=value),
        finding("above-table", "message", point=np.array([0.0, value, 0.0])),
        finding("above-table", "message", s_range_m=(0.0, value)),
    ):
        with pytest.raises(ValueError, match="finite"):
            finding_json(found)
