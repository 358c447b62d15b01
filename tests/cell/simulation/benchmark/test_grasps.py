import pytest

from cell.simulation.benchmark.grasps import (
    MAX_SIMULATED,
    TOP,
    GraspCase,
    GraspResult,
    run_grasp_case,
    simulated_ranks,
    summarise_grasps,
)


def test_the_best_grasps_and_a_spread_of_the_others_are_simulated() -> None:
    assert simulated_ranks(0) == []
    assert simulated_ranks(12) == list(range(12))
    ranks = simulated_ranks(100)
    assert ranks[:TOP] == list(range(TOP))
    assert ranks == sorted(set(ranks))
    assert (len(ranks), ranks[-1]) == (MAX_SIMULATED, 99)


def test_a_summary_counts_simulated_and_disturbed_grasps_separately() -> None:
    good = GraspResult(0, True, True, False, False, (), False, False)
    slips = GraspResult(1, True, False, False, True, ("+x", "down"), True, True)
    unknown = GraspResult(2, False, None, None, None, None, None, None)
    summaries = summarise_grasps([GraspCase("paper", 0, None, (good, slips, unknown)), GraspCase("paper", 1, "x: y")])
    best, top, every = summaries.values()
    assert (best.scenes, best.without_grasp, best.simulated, best.good, best.clean) == (1, 1, 1, 1.0, 1.0)
    assert (best.with_errors, best.good_with_errors, best.touching_with_errors) == (1, 1.0, 0.0)
    assert (top.simulated, top.good, top.touching, top.clean) == (2, 0.5, 0.5, 0.6667)
    assert (top.good_with_errors, top.wrong_string_with_errors) == (0.5, 0.5)
    assert every == top
    assert summarise_grasps([])["best"].good is None


@pytest.mark.slow
def test_a_case_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cell.simulation.benchmark.grasps.TOP", 1)
    monkeypatch.setattr("cell.simulation.benchmark.grasps.MAX_SIMULATED", 3)
    case = run_grasp_case(("soft", 0), "ideal")
    assert case.refused is None
    assert [grasp.rank for grasp in case.grasps if grasp.good is not None] == [0, 1, len(case.grasps) - 1]
    best = case.grasps[0]
    assert best.good
    assert best.clean
    assert best.failing_errors == ()
