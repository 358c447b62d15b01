"""Surface above the table that is in no chain is reported, and chains beside it may be objects."""

from dataclasses import replace

import numpy as np
import pytest

from recognition.assembly.unexplained import (
    MAX_BESIDE_SHARE,
    MAX_LISTED_PIECES,
    find_unexplained_surface,
    possible_object_findings,
    unexplained_findings,
)
from recognition.model.chains import Chain
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters


def line(start_mm: tuple[float, float], end_mm: tuple[float, float], spacing_mm: float) -> np.ndarray:
    a, b = np.array([*start_mm, 4.2]) / 1000, np.array([*end_mm, 4.2]) / 1000
    return np.linspace(a, b, round(np.linalg.norm(b - a) / (spacing_mm / 1000)) + 1)


def chain(points: np.ndarray, closed: bool = False) -> Chain:
    count = len(points)
    return Chain(0, closed, 0.0042, points, np.zeros(count), np.ones(count, dtype=np.int64), ("free", "free"))


def notes_on(surface: np.ndarray, chains: list[Chain], parameters: ChainParameters) -> list[Finding]:
    findings = unexplained_findings(find_unexplained_surface(surface, chains, parameters), parameters)
    assert all(found.severity == "note" and found.chains == () for found in findings)
    return findings


# Points so far apart that the middles of links are more than 2 r from both.
ALONG_X = chain(line((0, 0), (100, 0), 20))


def test_the_surface_of_a_chain_is_explained(table_1: ChainParameters) -> None:
    beside = line((0, 8), (100, 8), 1)
    assert notes_on(beside, [ALONG_X], table_1) == []


def test_the_surface_of_a_thicker_chain_is_explained(table_1: ChainParameters) -> None:
    beside = line((0, 11), (100, 11), 1)
    assert len(notes_on(beside, [ALONG_X], table_1)) == 1
    assert notes_on(beside, [replace(ALONG_X, radius_m=0.006)], table_1) == []


def test_other_surface_is_reported_with_size_and_position(table_1: ChainParameters) -> None:
    surface = np.vstack([line((0, 4), (100, 4), 1), line((20, 30), (60, 30), 1)])
    (found,) = notes_on(surface, [ALONG_X], table_1)
    assert found.code == "unexplained-surface"
    assert (found.value, found.limit) == pytest.approx((0.04, table_1.r_cn), abs=1e-12)
    assert found.point_m == pytest.approx((0.04, 0.03, 0.0042), abs=1e-12)
    assert found.message == "something of 40 mm at (40, 30, 4) mm is above the table and in no chain"


def test_pieces_smaller_than_r_cn_are_noise(table_1: ChainParameters) -> None:
    # r_cn = 12.6 mm. Two pieces more than r apart are two, even if together they are larger.
    assert notes_on(line((20, 30), (32, 30), 1), [ALONG_X], table_1) == []
    two = np.vstack([line((20, 30), (30, 30), 1), line((35, 30), (45, 30), 1)])
    assert notes_on(two, [ALONG_X], table_1) == []
    assert len(notes_on(line((20, 30), (33, 30), 1), [ALONG_X], table_1)) == 1


def test_the_largest_come_first_and_the_rest_are_counted(table_1: ChainParameters) -> None:
    surface = np.vstack([line((0, 30 + 10 * k), (20 + k, 30 + 10 * k), 1) for k in range(MAX_LISTED_PIECES + 2)])
    *listed, further = notes_on(surface, [ALONG_X], table_1)
    assert [found.code for found in listed] == ["unexplained-surface"] * MAX_LISTED_PIECES
    assert [found.value for found in listed] == pytest.approx([0.026, 0.025, 0.024, 0.023, 0.022], abs=1e-12)
    assert (further.code, further.value) == ("more-unexplained-surface", 2)
    assert further.message.startswith(
        "2 more things of 20 to 21 mm are above the table and in no chain, the largest at"
    )
    assert further.point_m is not None
    assert further.point_m[1] == pytest.approx(0.04)


def test_a_closed_chain_explains_its_closing_link(table_1: ChainParameters) -> None:
    corners = np.array([(0, 0, 4.2), (60, 0, 4.2), (60, 60, 4.2), (0, 60, 4.2)]) / 1000
    side = line((0, 0), (0, 60), 1)
    assert notes_on(side, [chain(corners, closed=True)], table_1) == []
    assert len(notes_on(side, [chain(corners)], table_1)) == 1


def test_without_chains_all_of_the_surface_is_reported(table_1: ChainParameters) -> None:
    """A table with strings of a radius other than the given one must not look like an empty table."""
    (found,) = notes_on(line((0, 0), (50, 0), 1), [], table_1)
    assert (found.code, found.value) == ("unexplained-surface", pytest.approx(0.05, abs=1e-12))
    assert found.point_m == pytest.approx((0.025, 0.0, 0.0042), abs=1e-12)
    assert notes_on(np.empty((0, 3)), [], table_1) == []
    assert notes_on(np.empty((0, 3)), [ALONG_X], table_1) == []


@pytest.mark.parametrize(("covered_mm", "is_object"), [(100, True), (60, True), (40, False)])
def test_a_chain_with_unexplained_surface_along_most_of_it_may_be_an_object(
    table_1: ChainParameters, covered_mm: int, is_object: bool
) -> None:
    string = replace(chain(line((0, 0), (100, 0), 1)), id=2)
    # 10 mm beside the string: more than 2 r, and less than 3 r.
    pieces = find_unexplained_surface(line((0, 10), (covered_mm, 10), 1), [string], table_1)
    findings = possible_object_findings(pieces, [string], table_1)
    assert len(findings) == is_object
    for found in findings:
        assert (found.code, found.severity, found.chains) == ("possible-object", "doubt", (2,))
        assert (found.crossing, found.end, found.s_range_m) == (None, None, None), "it concerns the whole chain"
        # Surface reaches 7.7 mm beyond its own end: sqrt(12.6^2 - 10^2).
        assert found.value == pytest.approx(min(covered_mm + 7.7, 100) / 100, abs=0.02)
        assert found.limit == MAX_BESIDE_SHARE


def test_surface_that_a_chain_explains_or_that_is_far_away_makes_no_object(table_1: ChainParameters) -> None:
    string = chain(line((0, 0), (100, 0), 1))
    assert possible_object_findings([], [string], table_1) == []
    assert possible_object_findings([line((0, 20), (100, 20), 1)], [string], table_1) == []
    assert possible_object_findings([line((0, 10), (100, 10), 1)], [], table_1) == []
