import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cell.simulation import cases
from cell.simulation.benchmark.accuracy import ALL, CaseResult, case_json, run_case, sigma_by_tier, summarise
from cell.simulation.benchmark.intervals import wilson_interval
from cell.simulation.benchmark.sigma_coverage import SigmaCounts, sigma_counts, sigma_shares
from cell.simulation.evaluation.metrics import Score
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.pose_errors import NO_ERRORS
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.model import METHODS


def simulated(views: int) -> SimulatedScan:
    return simulate(make_scene("arc", 1), camera_model("exact", (320, 200)), 1, NO_ERRORS, views=views)


def make_score(**changes: Any) -> Score:
    values: dict[str, Any] = {
        "name": "x", "strings": 1, "chains": 1, "true_ends": 2, "true_crossings": 1, "crossings": 1,
        "mean_m": 0.001, "p95_m": 0.002, "shape_m": 0.0005, "end_m": 0.003,
        "cover": 1.0, "topology": True, "confident_mistakes": 0,
    }  # fmt: skip
    return Score(**values | changes)


def test_a_case_gives_the_same_results_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = simulated(views=4)
    monkeypatch.setattr(cases, "simulate", lambda case: scan)
    first, second = (run_case(("paper", 0)) for _ in range(2))
    assert [result.method for result in first] == list(METHODS)
    for result in first:
        assert (result.tier, result.seed, result.refused) == ("paper", 0, None)
        assert result.score is not None
        assert result.score.cover > 0.9
        assert result.sigma is not None
        assert result.sigma.seen > 0
    assert json.dumps([case_json(result) for result in first], allow_nan=False) == json.dumps(
        [case_json(result) for result in second], allow_nan=False
    )


def test_a_refused_case_counts_as_wrong_and_has_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = simulated(views=1)
    (view,) = scan.views
    scan = replace(scan, views=(replace(view, depth=np.zeros_like(view.depth)),))
    monkeypatch.setattr(cases, "simulate", lambda case: scan)
    results = run_case(("paper", 0))
    for result in results:
        assert result.score is None
        assert result.refused is not None
        assert result.refused.startswith("no-depth: ")
    for summary in summarise(results)["paper"].values():
        assert (summary.n, summary.topology, summary.refused, summary.cover) == (1, 0.0, 1, 0.0)
        assert summary.mean_mm is None
    assert sigma_by_tier(results)["paper"][METHODS[0]]["within_2_sigma"] is None


def test_an_unexpected_exception_has_a_note_that_names_the_case(monkeypatch: pytest.MonkeyPatch) -> None:
    def fault(*_: object) -> None:
        raise ZeroDivisionError("a fault")

    scan = simulated(views=1)
    monkeypatch.setattr(cases, "simulate", lambda case: scan)
    monkeypatch.setattr("recognition.pipeline.recognise", fault)
    with pytest.raises(ZeroDivisionError) as caught:
        run_case(("soft", 3))
    assert caught.value.__notes__ == [f"while {METHODS[0]} recognised soft, seed 3"]


def test_a_case_without_a_model_counts_as_the_worst_in_medians() -> None:
    scores = [
        make_score(mean_m=0.001),
        make_score(mean_m=0.002, topology=False),
        make_score(mean_m=0.004, confident_mistakes=2),
    ]
    results = [CaseResult("soft", k, "enhanced", s) for k, s in enumerate(scores)]
    summary = summarise(results)["soft"]["enhanced"]
    assert (summary.n, summary.mean_mm, summary.p95_mm, summary.shape_mm, summary.end_mm) == (3, 2.0, 2.0, 0.5, 3.0)
    assert (summary.topology, summary.confident_mistakes) == (0.6667, 2)
    assert summary.topology_interval_95 == wilson_interval(2 / 3, 3)
    refused = [CaseResult("soft", 3 + k, "enhanced", None, "no-depth: nothing") for k in range(2)]
    worse = summarise([*results, *refused])["soft"]["enhanced"]
    assert (worse.n, worse.mean_mm, worse.topology, worse.refused) == (5, 4.0, 0.4, 2)
    assert summarise([results[0], *refused])["soft"]["enhanced"].mean_mm is None


def test_results_are_grouped_by_tier_and_method() -> None:
    results = [
        CaseResult("paper", 0, "enhanced", make_score(), sigma=SigmaCounts(10, 9, 2, 1)),
        CaseResult("paper", 0, "matching", make_score(topology=False), sigma=SigmaCounts(10, 1)),
        CaseResult("hard", 0, "enhanced", make_score(cover=0.5), sigma=SigmaCounts(30, 27)),
    ]
    summaries = summarise(results)
    assert {tier: list(methods) for tier, methods in summaries.items()} == {
        "paper": ["enhanced", "matching"],
        "hard": ["enhanced"],
    }
    assert summaries["hard"]["enhanced"].cover == 0.5
    shares = sigma_by_tier(results)
    assert set(shares) == {ALL, "paper", "hard"}
    assert shares[ALL]["enhanced"]["n_points"] == 42
    assert shares[ALL]["enhanced"]["within_2_sigma"] == pytest.approx(37 / 42, abs=1e-4)
    seen = {"within_2_sigma": 0.1, "within_2_sigma_interval_95": wilson_interval(0.1, 1), "n_points": 10}
    bridged = {"within_2_sigma": None, "within_2_sigma_interval_95": None, "n_points": 0}
    assert shares["paper"]["matching"] == {**seen, "seen": seen, "bridged": bridged}


def test_sigma_counts_the_points_within_two_sigma() -> None:
    truth = {"name": "bar", "radius": 0.004, "curves": [[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]], "crossings": []}
    off = np.array([0.0, 0.0019, 0.0021, 0.0039, 0.0041])
    chain = {
        "points": [[0.01 * (k + 1), y, 0.0] for k, y in enumerate(off)],
        "sigma_m": [0.0, 0.001, 0.001, 0.002, 0.002],
        "views": [4, 8, 1, 0, 0],
    }
    counts = sigma_counts({"chains": [chain]}, truth)
    assert counts == SigmaCounts(seen=3, seen_within=2, bridged=2, bridged_within=1)
    assert sigma_shares([counts, counts])["within_2_sigma"] == 0.6
    assert sigma_counts({"chains": []}, truth) == SigmaCounts()
    assert sigma_counts({"chains": [chain]}, truth | {"curves": []}) == SigmaCounts(seen=3, bridged=2)
