"""Cases of strings that fell onto the table."""

import sys

import numpy as np
import pytest

from cell.simulation.cases import Case, make_case
from cell.simulation.cases.heap_tier import (
    CROSSINGS,
    MIN_ANGLE_RAD,
    MIN_BEND_RADII,
    MIN_END_RADII,
    TOTAL_M,
    tightest_bend_m,
)
from cell.simulation.scenes.planar_crossings import at, plan_crossings
from cell.simulation.scenes.strand_clearance import deepest_overlap
from cell.simulation.string_physics.heap_drop import PhysicsError, drop
from recognition.geometry.polyline import arc_length

pytestmark = pytest.mark.slow

SEEDS = (3, 7)
"""Seeds whose first drop is a case, so that the test is fast."""


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [make_case("heap", seed) for seed in SEEDS]


def test_one_to_five_strings_in_turn_lie_on_each_other(cases: list[Case]) -> None:
    assert [len(case.scene.curves) for case in cases] == [seed % 5 + 1 for seed in SEEDS]
    for case in cases:
        found = plan_crossings(case.scene.curves)
        total_m = sum(float(arc_length(curve)[-1]) for curve in case.scene.curves)
        assert TOTAL_M[0] * 0.97 <= total_m <= TOTAL_M[1] * 1.03
        assert CROSSINGS[0] <= len(found) <= CROSSINGS[1]
        assert min(crossing.angle_rad for crossing in found) >= MIN_ANGLE_RAD
        for crossing in found:
            for string, position in (crossing.first, crossing.second):
                to_end = min(position, len(case.scene.curves[string]) - 1 - position)
                # Points are 1 mm apart.
                assert to_end * 0.001 >= 0.99 * MIN_END_RADII * case.scene.radius_m
        assert max(float(curve[:, 2].max()) for curve in case.scene.curves) > 4 * case.scene.radius_m


def test_strings_are_continuous_bend_gently_and_do_not_intersect(cases: list[Case]) -> None:
    for case in cases:
        for curve in case.scene.curves:
            steps_m = np.linalg.norm(np.diff(curve, axis=0), axis=1)
            assert 0.0008 <= steps_m.min() <= steps_m.max() <= 0.00101
            assert curve[:, 2].min() >= case.scene.radius_m
            assert tightest_bend_m(curve) >= MIN_BEND_RADII * case.scene.radius_m
        assert deepest_overlap(case.scene.curves, case.scene.radii_m) <= 0.05


def test_strands_at_a_crossing_are_a_diameter_apart_and_the_heap_has_come_to_rest(cases: list[Case]) -> None:
    for case in cases:
        curves, radius_m = case.scene.curves, case.scene.radius_m
        for crossing in plan_crossings(curves):
            (a, s), (b, t) = crossing.first, crossing.second
            assert abs(at(curves[a], s)[2] - at(curves[b], t)[2]) >= 1.9 * radius_m
        heights = np.concatenate([curve[:, 2] for curve in curves]) / radius_m
        # A string that still falls would have a large part in the air.
        assert np.median(heights) < 3
        assert heights.max() < 12


def test_a_strand_that_falls_across_another_lies_over_it() -> None:
    x = np.linspace(-0.1, 0.1, 201)
    lower = np.column_stack([x, 0 * x, np.full(len(x), 0.02)])
    upper = np.column_stack([0 * x, x, np.full(len(x), 0.04)])
    first, second = drop([lower, upper], 0.003, 20.0)
    assert first[:, 2].max() < 0.0045
    assert second[100, 2] == pytest.approx(0.009, abs=0.0005)
    assert second[[0, -1], 2] == pytest.approx(0.003, abs=0.0005)


def test_without_mujoco_only_the_heaps_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(PhysicsError, match=r"heaps of strings need MuJoCo.*install the extra `dev`"):
        make_case("heap", SEEDS[0])
    assert make_case("paper", 0).scene.curves
