"""Findings on bends that a string does not make."""

import numpy as np
import pytest

from recognition.assembly.sharp_bends import MAX_BEND_RAD, MAX_LOOSE_BEND_RAD, sharp_bend_findings
from recognition.geometry.polyline import arc_length, points_at
from recognition.model.chains import Chain
from recognition.model.findings import Finding
from recognition.parameters import ChainParameters


def chain(table_1: ChainParameters, *corners_mm: tuple[float, float]) -> Chain:
    """Return an open chain through the corners, with points 4.2 mm apart."""
    corners = np.array([(x, y, 4.2) for x, y in corners_mm]) / 1000
    s = arc_length(corners)
    points = points_at(corners, np.linspace(0, s[-1], round(s[-1] / 0.0042) + 1))
    n = len(points)
    return Chain(0, False, table_1.r, points, np.full(n, 0.0002), np.ones(n, dtype=np.int64), ("free", "free"))


def bends(degrees: float, table_1: ChainParameters) -> list[Finding]:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return sharp_bend_findings([chain(table_1, (0, 0), (50.4, 0), (50.4 + 50.4 * c, 50.4 * s))])


@pytest.mark.parametrize(
    ("degrees", "code", "severity", "limit"),
    [(100, "tight-bend", "doubt", MAX_LOOSE_BEND_RAD), (130, "sharp-bend", "blocking", MAX_BEND_RAD)],
)
def test_a_sharp_bend_is_a_finding_with_its_position(
    table_1: ChainParameters, degrees: float, code: str, severity: str, limit: float
) -> None:
    (found,) = bends(degrees, table_1)
    assert (found.code, found.severity, found.chains) == (code, severity, (0,))
    # The corner is a point of the chain, and the directions are measured on two points before and after it.
    assert found.point_m == pytest.approx((0.0504, 0.0, 0.0042), abs=1e-9)
    assert found.s_range_m == pytest.approx((0.0504 - 0.0084, 0.0504 + 0.0084), abs=1e-9)
    assert found.value == pytest.approx(np.radians(degrees), abs=1e-9)
    assert found.limit == pytest.approx(limit, abs=1e-12)
    assert found.message.startswith("chain 0 bends sharply at (50, 0, 4) mm")


@pytest.mark.parametrize("degrees", [0, 60, 74])
def test_a_loose_string_has_no_sharp_bend(table_1: ChainParameters, degrees: float) -> None:
    assert bends(degrees, table_1) == []


def test_a_string_around_one_of_its_own_size_bends_less_than_the_limit(table_1: ChainParameters) -> None:
    """The centre line of a string that touches itself in a half turn has a bend radius of one radius, the smallest."""
    r, turn = table_1.r, np.linspace(0, np.pi, 8)
    arc = r * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    corners = np.vstack([[(-0.05, 0)], arc, [(-0.05, 2 * r)]]) * 1000
    (found,) = sharp_bend_findings([chain(table_1, *((float(x), float(y)) for x, y in corners))])
    assert found.code == "tight-bend"


def test_each_sharp_bend_is_found(table_1: ChainParameters) -> None:
    zigzag = chain(table_1, (0, 0), (50.4, 0), (50.4, 50.4), (100.8, 50.4), (100.8, 0))
    found = sorted(one.point_m for one in sharp_bend_findings([zigzag]) if one.point_m is not None)
    assert np.array(found) == pytest.approx(
        np.array([(0.0504, 0, 0.0042), (0.0504, 0.0504, 0.0042), (0.1008, 0.0504, 0.0042)]), abs=1e-9
    )


def test_a_short_chain_has_no_bend(table_1: ChainParameters) -> None:
    assert sharp_bend_findings([chain(table_1, (0, 0), (13, 0))]) == []
    assert sharp_bend_findings(()) == []


@pytest.mark.parametrize("first", range(40))
def test_a_sharp_bend_of_a_ring_is_found_wherever_the_ring_begins(table_1: ChainParameters, first: int) -> None:
    # A drop: three quarters of a circle of 24 mm radius, and its tangents, which meet at a right angle in the tip.
    turn = np.linspace(-0.75 * np.pi, 0.75 * np.pi, 28)
    arc = 0.024 * np.column_stack([np.cos(turn), np.sin(turn)])
    tip = np.array([-0.024 * np.sqrt(2), 0.0])
    drop = np.vstack([np.linspace(tip, arc[0], 6, endpoint=False), arc, np.linspace(tip, arc[-1], 7)[5:0:-1]])
    points = np.column_stack([np.roll(drop, -first, axis=0), np.full(len(drop), 0.0042)])
    n = len(points)
    ring = Chain(0, True, table_1.r, points, np.full(n, 0.0002), np.ones(n, dtype=np.int64), ("free", "free"))
    (found,) = sharp_bend_findings([ring])
    assert found.value == pytest.approx(np.pi / 2, abs=1e-9)
    assert found.point_m == pytest.approx((*tip, 0.0042), abs=1e-9)
    # Two links of 4 mm before and after the tip.
    assert found.s_range_m is not None
    start, stop = found.s_range_m
    assert stop - start == pytest.approx(0.016, abs=1e-9)
    assert 0 <= start < ring.length_m
