"""The grasps of a model are counted by what they truly touch."""

import numpy as np
import pytest

from cell.simulation.benchmark.accuracy import CaseResult, grasps_by_tier
from cell.simulation.benchmark.grasp_counts import JudgedGrasps, count_grasps, judge_grasps
from cell.simulation.benchmark.tables import grasps_table
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.model.grasps import ScoredGrasp

R = 0.004


@pytest.fixture
def scene() -> StringScene:
    """A string along y, with a bar 5 mm high that begins at x = 8 mm, and is 40 mm long in y around the origin."""
    y = np.arange(-0.1, 0.1001, 0.001)
    line = np.column_stack([np.zeros_like(y), y, np.full_like(y, R)])
    return StringScene("bar-0", R, (line,), (Box((0.013, 0.0), (0.010, 0.04, 0.005), 0.0),))


def grasp(*, x: float = 0.0, y: float, reach_m: float = 0.003) -> ScoredGrasp:
    T = np.diag([-1.0, 1.0, -1.0, 1.0])
    T[:3, 3] = x, y, R
    return ScoredGrasp(0, y + 0.1, T, 0.014, reach_m, 0.03, R - reach_m, 1.0)


def test_each_contact_counts(scene: StringScene) -> None:
    free, on_bar, too_deep = grasp(y=0.05), grasp(y=0.0), grasp(y=-0.06, reach_m=0.005)
    beside = grasp(x=-0.006, y=0.05)
    found = judge_grasps([free, on_bar, too_deep, beside], scene)
    assert found == JudgedGrasps(
        grasps=4,
        on_table=1,
        on_object=1,
        on_string=0,
        on_gripped=1,
        by_palm=0,
        off_string=1,
        touching=2,
        best_touches=False,
    )
    assert judge_grasps([on_bar], scene).best_touches
    assert judge_grasps([], scene).grasps == 0


def test_counts_are_by_tier_and_kind(scene: StringScene) -> None:
    free, touching, none = (judge_grasps(grasps, scene) for grasps in ([grasp(y=0.05)], [grasp(y=0.0)] * 2, []))
    counts = count_grasps([free, touching, none])
    assert (counts.scenes, counts.with_grasps, counts.with_touching, counts.best_touching) == (3, 2, 1, 1)
    assert (counts.grasps, counts.on_object, counts.touching) == (3, 2, 2)
    results = [
        CaseResult("paper", 0, "graph", None, grasps=free),
        CaseResult("paper", 0, "enhanced", None),
        CaseResult("fixtures", 0, "graph", None, grasps=touching, kind="bar"),
        CaseResult("fixtures", 1, "graph", None, grasps=none, kind="plate"),
    ]
    by_tier = grasps_by_tier(results)
    assert list(by_tier) == ["paper", "fixtures bar", "fixtures plate"]
    rows = grasps_table(by_tier).splitlines()
    assert rows[3] == "| fixtures bar | 1 | 0 | 2 | 0 | 2 | 0 | 0 | 0 | 0 | 1 |"
