"""`pointchain bench`: how right and how fast recognition, the simulated cell and the service are, as tables or JSON."""

import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from platform import python_version
from typing import Any

from cell.simulation.benchmark import accuracy, tables
from cell.simulation.benchmark.growth import Growth, measure_growth
from cell.simulation.benchmark.speed import Speed, measure_speed
from cell.simulation.tiers import TIERS
from recognition.model import METHODS
from service.bench_cell import cell_table, measure_cell
from service.bench_service import measure_service, service_json, service_table

START_S, SIMULATE_S, RECOGNISE_S = 5.0, 3.0, 1.0
"""What accuracy takes on one core, about: once, for each scene, and for each of its methods."""
SPEED_S, CELL_S, SERVICE_S = 90.0, 240.0, 360.0
"""What the speed part, the cell's and the service's take, about. All are only to say how long it will be."""


def bench(only: str | None, tiers: Sequence[str], seeds: int, jobs: int | None, as_json: bool) -> int:
    """Runs the part `only`, "speed", "cell", "service" or "accuracy", or all; Markdown tables or one JSON document on
    stdout.

    `tiers` are names of `cell.simulation.tiers`, all when empty; `seeds` scenes of each are recognised by every
    method, on `jobs` processes (one a core when None). Returns 0, or 1 when it is wrongly called.
    """
    unknown = [tier for tier in tiers if tier not in TIERS]
    if unknown:
        return _refuse(f"there is no tier {unknown[0]!r}; known are {', '.join(TIERS)}")
    if seeds < 1 or (jobs is not None and jobs < 1):
        return _refuse("--seeds and --jobs must be at least 1")
    tiers, jobs = tiers or TIERS, jobs or os.cpu_count() or 1
    _say(_announcement(only, len(tiers) * seeds, jobs))
    document: dict[str, Any] = {"machine": {"cores": os.cpu_count(), "python": python_version()}}
    parts = []
    if only in (None, "speed"):
        speed, growth = measure_speed(_say), measure_growth(_say)
        document |= _speed_json(speed, growth)
        parts += [tables.speed_table(speed), tables.stages_table(speed.stages), tables.growth_table(growth)]
    if only in (None, "cell"):
        times = measure_cell(_say)
        document["cell"] = {name: round(value, 4) for name, value in asdict(times).items()}
        parts.append(cell_table(times))
    if only in (None, "service"):
        served = measure_service(_say)
        document["service"] = service_json(served)
        parts.append(service_table(served))
    if only in (None, "accuracy"):
        results = _run(tiers, seeds, jobs)
        summaries, sigma = accuracy.accuracy(results), accuracy.sigma(results)
        document |= {
            "accuracy": {
                tier: {method: asdict(summary) for method, summary in methods.items()}
                for tier, methods in summaries.items()
            },
            "sigma": sigma,
            "cases": [accuracy.case_json(result) for result in results],
        }
        parts += [tables.accuracy_table(summaries), tables.sigma_table(sigma)]
    print(json.dumps(document, allow_nan=False) if as_json else "\n\n".join(parts))
    return 0


def _run(tiers: Sequence[str], seeds: int, jobs: int) -> list[accuracy.CaseResult]:
    """All cases, with a progress bar on a terminal, else a line a tier, on stderr."""
    from tqdm import tqdm

    began, done = time.monotonic(), dict.fromkeys(tiers, 0)
    terminal = sys.stderr.isatty()
    with tqdm(total=len(tiers) * seeds, unit="scene", disable=not terminal) as bar:

        def on_done(tier: str) -> None:
            done[tier] += 1
            bar.set_description(tier)
            bar.update()
            if done[tier] == seeds and not terminal:
                _say(f"accuracy: {tier} done after {time.monotonic() - began:.0f} s")

        return list(accuracy.run(tiers, seeds, jobs, on_done))


def _announcement(only: str | None, scenes: int, jobs: int) -> str:
    parts, seconds = [], 0.0
    if only in (None, "speed"):
        parts.append("speed, memory and growth")
        seconds += SPEED_S
    if only in (None, "cell"):
        parts.append("the simulated cell")
        seconds += CELL_S
    if only in (None, "service"):
        parts.append("the service under load")
        seconds += SERVICE_S
    if only in (None, "accuracy"):
        parts.append(f"{scenes} scenes by {', '.join(METHODS)} on {jobs} process{'es' if jobs > 1 else ''}")
        seconds += START_S + scenes * (SIMULATE_S + RECOGNISE_S * len(METHODS)) / min(jobs, scenes)
    about = f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"
    return f"{'; '.join(parts)}: about {about}"


def _speed_json(speed: Speed, growth: Growth) -> dict[str, Any]:
    figures = asdict(speed)
    stages = figures.pop("stages")
    return {
        "speed": {name: round(value, 4) for name, value in figures.items()},
        "stages": {stage: round(seconds, 4) for stage, seconds in stages.items()},
        "growth": asdict(growth) | {"linear": growth.linear()},
    }


def _refuse(reason: str) -> int:
    _say(reason)
    return 1


def _say(text: str) -> None:
    print(f"pointchain bench: {text}", file=sys.stderr)
