from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from cell.simulation.cases import Case, make_case
from cell.simulation.cases.tight_tier import KNOTS, TAIL_M, loose_knot
from cell.simulation.scenes.planar_crossings import at, plan_crossings
from cell.simulation.scenes.strand_clearance import deepest_overlap
from cell.simulation.string_physics.knot_tightening import core_range, core_size
from recognition.geometry.polyline import arc_length

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("tight")]  # one process draws the cases

DETERMINANTS = {"overhand": 3, "figure-eight": 5, "square": 9}
"""Determinant of each knot with its ends joined: 1 is no knot, 3 a trefoil, 5 a figure-eight, 9 two trefoils."""


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    return [make_case("tight", seed) for seed in range(6)]


def determinant(curves: Sequence[NDArray[np.float64]], over: Sequence[bool] | None = None) -> int:
    """Return the determinant of the knot that joins the strings at their first and at their last points.

    `over` says whether the first strand of each crossing is the upper one, None by the heights. The joints pass outside
    the knot. Source: Livingston, "Knot theory" (1993), section 3.3, colourings modulo p.
    """
    unders: list[list[tuple[float, int]]] = [[] for _ in curves]
    crossings = plan_crossings(curves)
    passes = []
    for k, crossing in enumerate(crossings):
        a, b = crossing.first, crossing.second
        first_is_over = over[k] if over is not None else at(curves[a[0]], a[1])[2] > at(curves[b[0]], b[1])[2]
        upper, lower = (a, b) if first_is_over else (b, a)
        passes.append((upper, lower))
        unders[lower[0]].append((lower[1], k))
    offsets = np.cumsum([0, *(len(u) + 1 for u in unders)])
    label = list(range(offsets[-1]))
    for k in range(len(curves)):
        # one string is closed by joining its two ends; two strings are joined at their first and at their last arcs
        label[offsets[k + 1] - 1] = offsets[1] - 1 if len(curves) > 1 else 0
        label[offsets[k]] = 0
    names = {name: k for k, name in enumerate(sorted(set(label)))}

    def arc(string: int, position: float) -> int:
        return names[label[offsets[string] + sum(s < position for s, _ in unders[string])]]

    rows = np.zeros((len(passes), len(names)))
    for row, (upper, lower) in zip(rows, passes, strict=True):
        row[arc(*upper)] += 2
        row[arc(lower[0], lower[1] - 1e-6)] -= 1
        row[arc(lower[0], lower[1] + 1e-6)] -= 1
    return round(abs(float(np.linalg.det(rows[1:, 1:]))))


@pytest.mark.parametrize("kind", KNOTS)
def test_the_loose_knot_is_the_named_one(kind: str) -> None:
    plans, over, _ = loose_knot(np.random.default_rng(0), kind)
    assert determinant(plans, over) == DETERMINANTS[kind]


def test_pulling_keeps_the_knot(cases: list[Case]) -> None:
    for case, kind in zip(cases, 2 * tuple(KNOTS), strict=True):
        assert case.scene.name.startswith(f"tight-{kind}")
        assert len(case.scene.curves) == (2 if kind == "square" else 1)
        assert determinant(case.scene.curves) == DETERMINANTS[kind]


def test_knots_are_tight_and_differ_in_size(cases: list[Case]) -> None:
    sizes = [core_size(case.scene.curves) / case.scene.radius_m for case in cases]
    assert all(5 <= size <= 12.5 for size in sizes)
    assert len({round(size, 1) for size in sizes}) >= 5


def test_strings_lie_on_the_table_and_overlap_by_at_most_5_percent(cases: list[Case]) -> None:
    for case in cases:
        radius_m = case.scene.radius_m
        assert 0.003 <= radius_m <= 0.005
        assert min(float(curve[:, 2].min()) for curve in case.scene.curves) >= radius_m
        assert deepest_overlap(case.scene.curves, case.scene.radii_m) <= 0.05


def test_tails_are_free_and_on_the_table(cases: list[Case]) -> None:
    for case in cases:
        core = core_range(case.scene.curves)
        assert core is not None
        for curve, (first, last) in zip(case.scene.curves, core, strict=True):
            s = arc_length(curve)
            tails_m = (s[int(first)], s[-1] - s[int(last)])
            assert all(TAIL_M[0] - 0.004 <= tail_m <= TAIL_M[1] + 0.004 for tail_m in tails_m)
            assert curve[[0, -1], 2] == pytest.approx(case.scene.radius_m, abs=1e-5)
