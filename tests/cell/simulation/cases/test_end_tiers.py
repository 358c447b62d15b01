"""Tiers of strings that end near another strand, and of joined strings."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from cell.simulation.cases import Case, make_case
from cell.simulation.cases.end_tiers import BRANCH_RADIUS_M, END_KINDS, RADII_M
from cell.simulation.scenes.ground_truth import true_crossings
from recognition.geometry.polyline import arc_length

SEEDS = range(len(END_KINDS))


def from_end_m(case: Case) -> float:
    """Return the arc length between the only crossing and the nearest end, metres."""
    (crossing,) = true_crossings(case.scene)
    lengths_m = [arc_length(curve)[-1] for curve in case.scene.curves]
    return min(min(s, lengths_m[string] - s) for string, s in (crossing["over"], crossing["under"]))


def nearest_end_m(case: Case) -> float:
    """Return the smallest distance between an end and another strand, in radii."""
    radius_m, distances_m = case.scene.radius_m, []
    for k, curve in enumerate(case.scene.curves):
        for line in (curve, curve[::-1]):
            others = [line[arc_length(line) > 8 * radius_m]]
            others += [other for n, other in enumerate(case.scene.curves) if n != k]
            distances_m.append(KDTree(np.vstack(others)).query(line[0])[0])
    return min(distances_m) / radius_m


@pytest.mark.parametrize("seed", SEEDS)
def test_the_kinds_of_ends_come_in_turn(seed: int) -> None:
    for turn in range(3):
        case = make_case("ends", seed + turn * len(END_KINDS))
        kind, r = END_KINDS[seed], case.scene.radius_m
        assert case.scene.name.startswith(kind)
        assert r in RADII_M
        assert len(case.scene.curves) == (1 if kind == "own-side" else 2)
        crossings = true_crossings(case.scene)
        assert len(crossings) == (1 if kind.startswith("beyond") else 0)
        if crossings:
            # The stub rises or falls, so it is a little longer than from above.
            assert 0.99 <= from_end_m(case) / r <= 3.7
            over = crossings[0]["over"][0]
            assert over == (1 if kind == "beyond-over" else 0)
        elif kind == "in-line":
            a, b = case.scene.curves
            assert 0.98 <= np.linalg.norm(a[-1] - b[0]) / r <= 4.01
        elif kind == "below":
            assert nearest_end_m(case) < 2.4
        else:
            assert 1.0 <= nearest_end_m(case) <= 3.7


@pytest.mark.parametrize("seed", range(4))
def test_branches_end_in_the_centre_line_of_their_trunk(seed: int) -> None:
    case = make_case("branches", seed)
    trunk, *branches = case.scene.curves
    assert BRANCH_RADIUS_M[0] <= case.scene.radius_m <= BRANCH_RADIUS_M[1]
    assert len(branches) in (1, 2)
    assert true_crossings(case.scene) == []
    for branch in branches:
        assert KDTree(trunk).query(branch[0])[0] < 1e-4
        beyond = branch[arc_length(branch) > 6 * case.scene.radius_m]
        assert KDTree(trunk).query(beyond)[0].min() > 2.9 * case.scene.radius_m
    assert all(np.array_equal(curve[:, 2], np.full(len(curve), case.scene.radius_m)) for curve in case.scene.curves)
