"""Measure the accuracy of recognition for each tier of simulated cases and each method."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.simulation.benchmark.finding_counts import FindingCounts, ModelFindings, count_findings, model_findings
from cell.simulation.benchmark.grasp_counts import GraspCounts, JudgedGrasps, count_grasps, judge_grasps
from cell.simulation.benchmark.intervals import Interval, wilson_interval
from cell.simulation.benchmark.sigma_coverage import SigmaCounts, sigma_counts, sigma_shares
from cell.simulation.benchmark.worker_pool import map_in_processes
from cell.simulation.evaluation.metrics import Score, score
from recognition.model.model import METHODS, Method

ALL = "all"
"""Key of the result for all tiers together."""


@dataclass(frozen=True)
class CaseResult:
    """Result of one method on one case."""

    tier: str
    """Name of the tier."""
    seed: int
    """Seed of the case."""
    method: Method
    """Method of recognition."""
    score: Score | None
    """Score of the model, or None if recognition refused the case."""
    refused: str | None = None
    """Slug and message of the refusal, or None if there is a model."""
    sigma: SigmaCounts | None = None
    """Points within two sigma of the truth, or None if recognition refused the case."""
    findings: ModelFindings | None = None
    """Verdict and findings of the model, or None if recognition refused the case."""
    grasps: JudgedGrasps | None = None
    """Grasps of a model of the method `graph`. None for other methods, or if recognition refused the case."""
    kind: str | None = None
    """Kind of the scene, in a tier that has several kinds of objects."""


@dataclass(frozen=True)
class Summary:
    """Result of one method on one tier.

    The distances and `cover` are medians over all cases. A distance is None if half of the cases or more have no
    distance to measure. A case without a model counts as infinite distance, cover 0 and wrong topology. Cases without
    true ends do not count for `end_mm`.
    """

    n: int
    """Number of cases."""
    topology: float
    """Share of the cases with the right topology (see `Score.topology`), 0 to 1."""
    topology_interval_95: Interval | None
    """95 % confidence interval of `topology`, or None without a case."""
    mean_mm: float | None
    """Median of `Score.mean_m`, millimetres."""
    p95_mm: float | None
    """Median of `Score.p95_m`, millimetres."""
    shape_mm: float | None
    """Median of `Score.shape_m`, millimetres."""
    end_mm: float | None
    """Median of `Score.end_m`, millimetres."""
    cover: float
    """Median of `Score.cover`, 0 to 1."""
    confident_mistakes: int
    """Number of crossings in all cases with over and under exchanged and a confidence above 0.9."""
    refused: int
    """Number of cases that recognition refused."""


def run_case(tier_and_seed: tuple[str, int], camera: CameraName = DEFAULT_CAMERA) -> list[CaseResult]:
    """Simulate a case once, and recognise it by every method.

    An error of recognition is a result. Any other exception is raised with a note that names the case.

    Args:
        tier_and_seed: Name of the tier and seed of the case.
        camera: Camera that sees the scene.

    Returns:
        One result for each of `METHODS`, in their order.
    """
    from cell.simulation.cases import make_case, simulate
    from cell.simulation.scenes.low_obstacles import kind_of
    from recognition.errors import RecognitionError
    from recognition.pipeline import recognise
    from recognition.preprocessing.target_cloud import Scene
    from recognition.request import RecognitionRequest

    tier, seed = tier_and_seed
    case = make_case(tier, seed, camera)
    scan, kind = simulate(case), kind_of(case.scene.name)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    results = []
    for method in METHODS:
        try:
            request = RecognitionRequest(method, scan.truth["radius"])
            recognised = recognise(scan.views, request, scene).model
            model = recognised.to_json()
        except RecognitionError as error:
            results.append(CaseResult(tier, seed, method, None, f"{error.slug}: {error}", kind=kind))
        except Exception as error:
            error.add_note(f"while {method} recognised {tier}, seed {seed}")
            raise
        else:
            results.append(
                CaseResult(
                    tier,
                    seed,
                    method,
                    score(model, scan.truth),
                    sigma=sigma_counts(model, scan.truth),
                    findings=model_findings(model),
                    # All methods have the same grasp planner.
                    grasps=judge_grasps(recognised.grasps, case.scene) if method == "graph" else None,
                    kind=kind,
                )
            )
    return results


def run_cases(
    tiers: Sequence[str],
    seeds: int,
    jobs: int,
    on_done: Callable[[str], object] | None = None,
    camera: CameraName = DEFAULT_CAMERA,
) -> Iterator[CaseResult]:
    """Yield the results of all cases: tier by tier, by seed, and by method.

    Args:
        tiers: Names of the tiers.
        seeds: Number of cases of each tier. Their seeds are 0, 1, ...
        jobs: Number of processes.
        on_done: Function that is called with the tier of each case before its results are yielded.
        camera: Camera that sees the scenes.

    Yields:
        One result for each case and method.
    """
    items = [(tier, seed) for tier in tiers for seed in range(seeds)]
    for results in map_in_processes(partial(run_case, camera=camera), items, jobs):
        if on_done is not None:
            on_done(results[0].tier)
        yield from results


def summarise(results: Iterable[CaseResult]) -> dict[str, dict[str, Summary]]:
    """Summarise the results by tier and by method."""
    return {
        tier: {method: _summarise(cases) for method, cases in methods.items()}
        for tier, methods in _group(results).items()
    }


def sigma_by_tier(results: Sequence[CaseResult]) -> dict[str, dict[str, Any]]:
    """Return the shares of chain points within two sigma of the truth, by tier and by method.

    Args:
        results: Results of cases. Refused cases do not count.

    Returns:
        The members of `sigma_shares`, by tier and method. The key `ALL` has all tiers together.
    """
    groups = _group(results)
    all_tiers = {method: [result for result in results if result.method == method] for method in _methods(results)}
    return {
        tier: {method: sigma_shares(case.sigma for case in cases if case.sigma) for method, cases in methods.items()}
        for tier, methods in {ALL: all_tiers, **groups}.items()
    }


def findings_by_tier(results: Iterable[CaseResult]) -> dict[str, dict[str, FindingCounts]]:
    """Return the verdicts and findings by tier and by method. Refused cases do not count."""
    return {
        tier: {
            method: count_findings([(case.score, case.findings) for case in cases if case.score and case.findings])
            for method, cases in methods.items()
        }
        for tier, methods in _group(results).items()
    }


def grasps_by_tier(results: Iterable[CaseResult]) -> dict[str, GraspCounts]:
    """Return the judged grasps of the method `graph` by tier, and by kind of object in a tier that has several."""
    groups: dict[str, list[JudgedGrasps]] = {}
    for result in results:
        if result.grasps is not None:
            groups.setdefault(" ".join(filter(None, (result.tier, result.kind))), []).append(result.grasps)
    return {name: count_grasps(judged) for name, judged in groups.items()}


def case_json(result: CaseResult) -> dict[str, Any]:
    """Return a result as JSON. The numbers are finite."""
    return asdict(result)


def _methods(results: Iterable[CaseResult]) -> list[str]:
    """Return the names of the methods in the order of their first result."""
    return list(dict.fromkeys(result.method for result in results))


def _group(results: Iterable[CaseResult]) -> dict[str, dict[str, list[CaseResult]]]:
    """Return the results by tier and by method."""
    groups: dict[str, dict[str, list[CaseResult]]] = {}
    for result in results:
        groups.setdefault(result.tier, {}).setdefault(result.method, []).append(result)
    return groups


def _summarise(cases: Sequence[CaseResult]) -> Summary:
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
    """Return the median in millimetres, or None if it is infinite. None counts as infinite."""
    values = [np.inf if distance is None else distance for distance in distances_m]
    median = float(np.median(values)) if values else np.inf
    return round(median * 1e3, 4) if np.isfinite(median) else None
