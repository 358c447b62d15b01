"""How often and how well recognition is right on simulated scenes with known truth."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from cell.simulation.scoring import Score
from recognition.model import METHODS, Method

TIER = "paper-like"
"""The scenes of `paper_like`: one string of 0.4 m, r = 4.2 mm, with 0 to 2 crossings, as in the paper."""


@dataclass(frozen=True)
class Case:
    """One simulated scene, by what it is made from."""

    seed: int
    crossings: int
    softness: float
    """Height between the centre lines at a crossing, as a share of 2 r."""


@dataclass(frozen=True)
class Result:
    """One method's model of one case."""

    case: Case
    method: Method
    score: Score
    recognise_s: float


@dataclass(frozen=True)
class Summary:
    """What one method reached over all cases; medians over the cases, millimetres."""

    n: int
    topology: float
    """Share of cases with every string, order and over/under right."""
    mean_mm: float
    shape_mm: float
    end_mm: float
    cover: float


def paper_like(count: int) -> list[Case]:
    """`count` cases: 0, 1, 2 crossings in turn, softness from 0.6 (pressed together) to 1.0 (hard)."""
    softness = np.random.default_rng(0).uniform(0.6, 1.0, count)
    return [Case(seed, seed % 3, float(softness[seed])) for seed in range(count)]


def run_case(case: Case) -> list[Result]:
    """The case simulated once and recognised by every method."""
    import time

    from cell.simulation.camera import camera_model
    from cell.simulation.scenes import make_scene
    from cell.simulation.scoring import score
    from cell.simulation.simulate import simulate
    from recognition.parameters import ChainParameters
    from recognition.pipeline import recognise
    from recognition.preprocess import Scene

    scene = make_scene("random", case.seed, softness=case.softness, crossings=case.crossings)
    scan = simulate(scene, camera_model("oak-d-pro"), case.seed)
    parameters = ChainParameters.for_radius(scene.radius_m)
    where = Scene(scan.header.table_z_m, scan.header.workspace_m)
    results = []
    for method in METHODS:
        start = time.perf_counter()
        model = recognise(scan.views, parameters, where, method).model
        seconds = time.perf_counter() - start
        results.append(Result(case, method, score(model.to_json(), scan.truth), seconds))
    return results


def run(
    cases: Sequence[Case], jobs: int | None = None, on_done: Callable[[], object] | None = None
) -> Iterator[Result]:
    """The results of all cases in their order, computed on `jobs` processes (all cores when None)."""
    with ProcessPoolExecutor(jobs or os.cpu_count(), mp_context=get_context("spawn")) as pool:
        for results in pool.map(run_case, cases):
            if on_done is not None:
                on_done()
            yield from results


def summarise(results: Sequence[Result]) -> dict[Method, Summary]:
    """One summary a method."""
    return {method: _summary([result.score for result in results if result.method == method]) for method in METHODS}


def table(summaries: dict[Method, Summary]) -> str:
    """The summaries as a Markdown table."""
    columns = ("method", "scenes", "topology right", "mean error", "shape error", "worst end", "cover")
    rows = [columns, ("---",) * len(columns)]
    for method, s in summaries.items():
        errors = (f"{s.mean_mm:.2f} mm", f"{s.shape_mm:.2f} mm", f"{s.end_mm:.1f} mm")
        rows.append((method, str(s.n), f"{s.topology:.1%}", *errors, f"{s.cover:.3f}"))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _summary(scores: Sequence[Score]) -> Summary:
    def median(name: str) -> float:
        values = np.array([getattr(score, name) for score in scores], dtype=np.float64)
        return float(np.median(values[np.isfinite(values)])) if np.isfinite(values).any() else float("nan")

    return Summary(
        n=len(scores),
        topology=float(np.mean([score.topology for score in scores])),
        mean_mm=median("mean_m") * 1e3,
        shape_mm=median("shape_m") * 1e3,
        end_mm=median("end_m") * 1e3,
        cover=median("cover"),
    )
