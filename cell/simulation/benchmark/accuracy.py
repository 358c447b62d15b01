"""Measure the accuracy of recognition, by tier of simulated cases and by method."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from cell.simulation.benchmark.intervals import Interval, wilson_interval
from cell.simulation.benchmark.sigma_coverage import SigmaCounts, sigma_counts, sigma_shares
from cell.simulation.benchmark.worker_pool import in_processes
from cell.simulation.evaluation.metrics import Score, score
from recognition.model.model import METHODS, Method

ALL = "all"
"""Name of the row for all tiers together."""


@dataclass(frozen=True)
class CaseResult:
    """Result of one method on one case."""

    tier: str
    seed: int
    method: Method
    score: Score | None
    """None when recognition refused the case."""
    refused: str | None = None
    """Reason for the refusal."""
    sigma: SigmaCounts | None = None


@dataclass(frozen=True)
class Summary:
    """Result of one method on one tier.

    The distances and `cover` are medians over all cases. A case without a model counts as the worst.
    """

    n: int
    """Number of cases."""
    topology: float
    """Share of cases with every string, order and over/under right."""
    topology_interval_95: Interval | None
    """95 % interval of this share."""
    mean_mm: float | None
    """None when half of the cases or more have no model to measure."""
    p95_mm: float | None
    shape_mm: float | None
    end_mm: float | None
    cover: float
    confident_mistakes: int
    """Number of crossings with over and under exchanged at a confidence above 0.9, in all cases."""
    refused: int
    """Number of cases that recognition refused."""


def run_case(tier_and_seed: tuple[str, int]) -> list[CaseResult]:
    """Simulate a case once, and recognise it by every method."""
    from cell.simulation.benchmark.cases import make_case, simulate
    from recognition.errors import RecognitionError
    from recognition.parameters import ChainParameters
    from recognition.pipeline import recognise
    from recognition.preprocessing.target_cloud import Scene

    tier, seed = tier_and_seed
    scan = simulate(make_case(tier, seed))
    surroundings = Scene(scan.header.table_z_m, scan.header.workspace_m)
    results = []
    for method in METHODS:
        try:
            parameters = ChainParameters.for_radius(scan.truth["radius"])
            model = recognise(scan.views, parameters, surroundings, method).model.to_json()
        except RecognitionError as error:
            results.append(CaseResult(tier, seed, method, None, f"{error.slug}: {error}"))
        except Exception as error:
            error.add_note(f"while {method} recognised {tier}, seed {seed}")
            raise
        else:
            results.append(
                CaseResult(tier, seed, method, score(model, scan.truth), sigma=sigma_counts(model, scan.truth))
            )
    return results


def run(
    tiers: Sequence[str], seeds: int, jobs: int, on_done: Callable[[str], object] | None = None
) -> Iterator[CaseResult]:
    """Yield the results of seeds 0, 1, ... of every tier, in that order, computed by `jobs` processes.

    `on_done` is called with the tier of each case, in the same order, just before its results are yielded.
    """
    for results in in_processes(run_case, [(tier, seed) for tier in tiers for seed in range(seeds)], jobs):
        if on_done is not None:
            on_done(results[0].tier)
        yield from results


def accuracy(results: Iterable[CaseResult]) -> dict[str, dict[str, Summary]]:
    """Return one summary for each tier and method."""
    return {
        tier: {method: _summary(cases) for method, cases in methods.items()}
        for tier, methods in _grouped(results).items()
    }


def sigma(results: Sequence[CaseResult]) -> dict[str, dict[str, Any]]:
    """Return the share of points within two sigma of the truth, by tier and method and for all tiers together."""
    groups = _grouped(results)
    together = {method: [result for result in results if result.method == method] for method in _methods(results)}
    return {
        tier: {method: sigma_shares(case.sigma for case in cases if case.sigma) for method, cases in methods.items()}
        for tier, methods in {ALL: together, **groups}.items()
    }


def case_json(result: CaseResult) -> dict[str, Any]:
    """Return one case as JSON. It has only finite numbers and None."""
    return asdict(result)


def _methods(results: Iterable[CaseResult]) -> list[str]:
    return list(dict.fromkeys(result.method for result in results))


def _grouped(results: Iterable[CaseResult]) -> dict[str, dict[str, list[CaseResult]]]:
    groups: dict[str, dict[str, list[CaseResult]]] = {}
    for result in results:
        groups.setdefault(result.tier, {}).setdefault(result.method, []).append(result)
    return groups


def _summary(cases: Sequence[CaseResult]) -> Summary:
    scores = [case.score for case in cases]
    with_ends = [s for s in scores if s is None or s.true_ends]
    topology = float(np.mean([s is not None and s.topology for s in scores]))
    return Summary(
        n=len(cases),
        topology=round(topology, 4),
        topology_interval_95=wilson_interval(topology, len(cases)),
        mean_mm=_median_mm(None if s is None else s.mean_m for s in scores),
        p95_mm=_median_mm(None if s is None else s.p95_m for s in scores),
        shape_mm=_median_mm(None if s is None else s.shape_m for s in scores),
        end_mm=_median_mm(None if s is None else s.end_m for s in with_ends),
        cover=round(float(np.median([0.0 if s is None else s.cover for s in scores])), 4),
        confident_mistakes=sum(s.confident_mistakes for s in scores if s is not None),
        refused=sum(case.refused is not None for case in cases),
    )


def _median_mm(distances_m: Iterable[float | None]) -> float | None:
    values = [np.inf if distance is None else distance for distance in distances_m]
    median = float(np.median(values)) if values else np.inf
    return round(median * 1e3, 4) if np.isfinite(median) else None
