"""Findings on bends that a string does not make."""

import numpy as np
import pytest

from recognition.assembly.sharp_bends import MAX_BEND_RAD, sharp_bend_findings
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


def test_a_sharp_bend_is_a_blocking_finding_with_its_position(table_1: ChainParameters) -> None:
    (found,) = bends(100, table_1)
    assert (found.code, found.severity, found.chains) == ("sharp-bend", "blocking", (0,))
    # The corner is a point of the chain, and the directions are measured on two points before and after it.
    assert found.point_m == pytest.approx((0.0504, 0.0, 0.0042), abs=1e-9)
    assert found.s_range_m == pytest.approx((0.0504 - 0.0084, 0.0504 + 0.0084), abs=1e-9)
    assert found.value == pytest.approx(np.radians(100), abs=1e-9)
    assert found.limit == pytest.approx(MAX_BEND_RAD, abs=1e-12)
    assert found.message.startswith("chain 0 bends sharply at (50, 0, 4) mm")
    assert bends(60, table_1) == []
    assert bends(0, table_1) == []


def test_a_short_chain_has_no_bend(table_1: ChainParameters) -> None:
    assert sharp_bend_findings([chain(table_1, (0, 0), (13, 0))]) == []
    assert sharp_bend_findings(()) == []
