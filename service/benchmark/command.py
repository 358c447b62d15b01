"""`pointchain bench`: measure accuracy, speed, the simulated cell, the service and grasps; print tables or JSON."""

import json
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from platform import python_version
from typing import Any

from cell.config.camera_names import CameraName
from cell.simulation.benchmark import accuracy, grasps, tables
from cell.simulation.benchmark.scaling import Growth, measure_growth
from cell.simulation.benchmark.speed import Speed, measure_speed
from cell.simulation.cases import TIERS
from recognition.model.model import METHODS
from service.benchmark.cell import cell_table, measure_cell
from service.benchmark.estimate import (
    accuracy_s,
    cell_s,
    duration,
    grasps_s,
    measure_probe,
    remaining_s,
    scene_cost,
    service_s,
    speed_s,
    views_s,
)
from service.benchmark.service import measure_service, service_json, service_table
from service.benchmark.service_process import MeasurementError
from service.benchmark.views import (
    VIEWS_COLUMNS,
    VIEWS_TIERS,
    ViewsCase,
    run_views_cases,
    summarise_views,
    views_row,
)

PARTS = ("speed", "cell", "service", "accuracy")
"""Parts that run unless one is chosen."""
GRASPS, VIEWS = "grasps", "views"
"""Parts that run only if they are chosen, because all tiers take long: grasps an hour or more."""
REPORT_S = 15.0
"""Time between two messages on the progress of a part."""

Emit = Callable[[str], None]


@dataclass(frozen=True)
class BenchOptions:
    """What is measured."""

    only: str | None
    """One of `PARTS`, `GRASPS` or `VIEWS`. None: all of `PARTS`."""
    tiers: tuple[str, ...]
    """Names of `cell.simulation.cases.TIERS`. Empty: all tiers that the part measures."""
    seeds: int
    """Number of scenes of each tier. Every method recognises each scene."""
    jobs: int | None
    """Number of processes of the parts on accuracy, grasps and views. None: one per core."""
    camera: CameraName
    """Camera of the parts on speed, accuracy, grasps and views."""


@dataclass(frozen=True)
class SceneSet:
    """Scenes of some tiers, and how they are measured."""

    tiers: tuple[str, ...]
    """Names of the tiers."""
    seeds: int
    """Number of scenes of each tier."""
    jobs: int
    """Number of processes."""
    camera: CameraName
    """Camera that sees the scenes."""

    @property
    def count(self) -> int:
        """Number of all scenes."""
        return len(self.tiers) * self.seeds


class Progress:
    """Report on stderr what is measured, and about how long the rest takes."""

    def __init__(self, estimates_s: Mapping[str, float]) -> None:
        self._estimates_s = dict(estimates_s)
        self._part = ""
        self._began_s = 0.0

    def begin(self, part: str) -> None:
        """Note that this part begins, and that the part before it has ended."""
        self._estimates_s.pop(self._part, None)
        self._part, self._began_s = part, time.monotonic()

    def left(self, share_done: float | None = None) -> str:
        """Return the time that this part and those after it still need.

        Args:
            share_done: Share of the work of this part that is done, 0 to 1. None: unknown.
        """
        pending_s = sum(self._estimates_s.values()) - self._estimates_s[self._part]
        part_s = remaining_s(self._estimates_s[self._part], time.monotonic() - self._began_s, share_done)
        return f"about {duration(pending_s + part_s)} left"

    def report(self, message: str) -> None:
        """Print a message with the time that is left."""
        _log(f"{message} ({self.left()})")


class SceneCount:
    """Counts the scenes of a part that are done, and reports on stderr from time to time."""

    def __init__(self, part: str, total: int, progress: Progress) -> None:
        self._part, self._total, self._progress = part, total, progress
        self._done, self._reported_s = 0, time.monotonic()

    def add(self, tier: str) -> None:
        """Count a scene of a tier."""
        self._done += 1
        if time.monotonic() - self._reported_s > REPORT_S and self._done < self._total:
            self.report(f"{self._done} of {self._total} scenes, at tier {tier}")
            self._reported_s = time.monotonic()

    def report(self, message: str) -> None:
        """Print a message with the time that is left."""
        _log(f"{self._part}: {message} ({self._progress.left(self._done / self._total)})")


def bench(options: BenchOptions, as_json: bool) -> int:
    """Run one part or all parts, and print the results on stdout.

    Each table is printed as soon as it is complete, and the accuracy table tier by tier. JSON is one document at the
    end.

    Args:
        options: What is measured.
        as_json: Print one JSON document instead of Markdown tables.

    Returns:
        Exit code: 0 on success, 1 if an argument is wrong or a part failed.
    """
    only = options.only
    known = VIEWS_TIERS if only == VIEWS else TIERS
    unknown = [tier for tier in options.tiers if tier not in known]
    if unknown:
        part = "" if only is None else f" in the part {only}"
        return _fail(f"there is no tier {unknown[0]!r}{part}; known are {', '.join(known)}")
    if options.seeds < 1 or (options.jobs is not None and options.jobs < 1):
        return _fail("--seeds and --jobs must be at least 1")
    tiers = tuple(dict.fromkeys(options.tiers or known))
    jobs = min(options.jobs or os.cpu_count() or 1, len(tiers) * options.seeds)
    scenes = SceneSet(tiers, options.seeds, jobs, options.camera)
    parts = PARTS if only is None else (only,)

    def emit(text: str) -> None:
        if not as_json:
            print(text, flush=True)

    progress = Progress(_estimates_s(parts, scenes))
    machine = {"cores": os.cpu_count(), "python": python_version()}
    document: dict[str, Any] = {"machine": machine, "camera": options.camera}
    for part in parts:
        progress.begin(part)
        if part != parts[0]:
            emit("")
        try:
            match part:
                case "speed":
                    document |= _speed(options.camera, progress, emit)
                case "cell":
                    times = measure_cell(progress.report)
                    emit(cell_table(times))
                    document["cell"] = {name: round(value, 4) for name, value in asdict(times).items()}
                case "service":
                    service_times = measure_service(progress.report)
                    emit(service_table(service_times))
                    document["service"] = service_json(service_times)
                case "grasps":
                    document |= _grasps(scenes, progress, emit)
                case "views":
                    document |= _views(scenes, progress, emit)
                case _:
                    document |= _accuracy(scenes, progress, emit)
        except MeasurementError as error:
            return _fail(f"the {part} part failed: {error}; run it on a machine that does nothing else")
    if as_json:
        print(json.dumps(document, allow_nan=False))
    return 0


def _estimates_s(parts: Sequence[str], scenes: SceneSet) -> dict[str, float]:
    """Time a probe on this machine, and return and announce the expected seconds of each part."""
    _log("timing a short probe to estimate the duration")
    estimates_s: dict[str, float] = {}
    tiers = scenes.tiers
    seeds = scenes.seeds
    jobs = scenes.jobs
    if set(parts) - {"accuracy", GRASPS, VIEWS}:
        probe = measure_probe(1, scenes.camera)
        all_s = {"speed": speed_s(probe), "cell": cell_s(probe), "service": service_s(probe)}
        estimates_s |= {part: all_s[part] for part in parts if part in all_s}
    if "accuracy" in parts:
        estimates_s["accuracy"] = accuracy_s(tiers, seeds, jobs, measure_probe(jobs, scenes.camera))
    if GRASPS in parts:
        estimates_s[GRASPS] = grasps_s(tiers, seeds, jobs, measure_probe(jobs, scenes.camera))
    if VIEWS in parts:
        estimates_s[VIEWS] = views_s(tiers, seeds, jobs, measure_probe(jobs, scenes.camera))
    processes = f"{jobs} process{'es' if jobs > 1 else ''}"
    described = {
        "speed": "speed, memory and growth",
        "cell": "the simulated cell",
        "service": "the service under load",
        "accuracy": f"accuracy on {scenes.count} scenes by {', '.join(METHODS)} in {processes}",
        GRASPS: f"simulated grasps in {scenes.count} scenes in {processes}",
        VIEWS: f"views as needed and eight views on {scenes.count} scenes in {processes}",
    }
    _log(f"this takes about {duration(sum(estimates_s.values()))}: {'; '.join(described[part] for part in parts)}")
    return estimates_s


def _speed(camera: CameraName, progress: Progress, emit: Emit) -> dict[str, Any]:
    speed = measure_speed(progress.report, camera)
    emit(f"{tables.speed_table(speed)}\n\n{tables.stages_table(speed.stages)}\n")
    growth = measure_growth(progress.report, camera)
    emit(tables.growth_table(growth))
    return _speed_json(speed, growth)


def _accuracy(scenes: SceneSet, progress: Progress, emit: Emit) -> dict[str, Any]:
    """Recognise all cases, with a progress bar on a terminal, else with a message from time to time."""
    from tqdm import tqdm

    seeds = scenes.seeds
    all_costs = [scene_cost(tier, seed) for tier in scenes.tiers for seed in range(seeds)]
    costs = iter(all_costs)
    total = sum(all_costs)
    done, reported_s = 0.0, time.monotonic()
    results: list[accuracy.CaseResult] = []
    emit(tables.table_head(tables.ACCURACY_COLUMNS))
    with tqdm(
        total=scenes.count,
        bar_format="accuracy: {n_fmt} of {total_fmt} scenes |{bar}| {desc}",
        disable=not sys.stderr.isatty(),
    ) as bar:

        def on_done(tier: str) -> None:
            nonlocal done, reported_s
            done += next(costs)
            left = progress.left(done / total)
            bar.set_description_str(left, refresh=False)
            bar.update()
            if bar.disable and time.monotonic() - reported_s > REPORT_S and done < total:
                _log(f"accuracy: at tier {tier} ({left})")
                reported_s = time.monotonic()

        case_results = accuracy.run_cases(scenes.tiers, seeds, scenes.jobs, on_done, scenes.camera)
        for tier in scenes.tiers:
            of_tier = list(islice(case_results, seeds * len(METHODS)))
            results += of_tier
            bar.clear()  # a terminal shows both stdout and the bar
            for row in tables.accuracy_rows(accuracy.summarise(of_tier)):
                emit(row)
            bar.refresh()
            if bar.disable:
                _log(f"accuracy: tier {tier} is done ({progress.left(done / total)})")
                reported_s = time.monotonic()
    summaries, sigma = accuracy.summarise(results), accuracy.sigma_by_tier(results)
    emit(f"\n{tables.sigma_table(sigma)}")
    findings = accuracy.findings_by_tier(results)
    emit(f"\n{tables.findings_table(findings)}")
    grasps = accuracy.grasps_by_tier(results)
    emit(f"\n{tables.grasps_table(grasps)}")
    return {
        "accuracy": {
            tier: {method: asdict(summary) for method, summary in methods.items()}
            for tier, methods in summaries.items()
        },
        "sigma": sigma,
        "findings": {
            tier: {method: asdict(counts) for method, counts in methods.items()} for tier, methods in findings.items()
        },
        "grasps": {name: asdict(counts) for name, counts in grasps.items()},
        "cases": [accuracy.case_json(result) for result in results],
    }


def _grasps(scenes: SceneSet, progress: Progress, emit: Emit) -> dict[str, Any]:
    """Simulate the grasps of all cases, with a message from time to time."""
    emit(tables.table_head(tables.GRASP_COLUMNS))
    done = SceneCount(GRASPS, scenes.count, progress)
    cases = grasps.run_grasp_cases(scenes.tiers, scenes.seeds, scenes.jobs, done.add, scenes.camera)
    results: list[grasps.GraspCase] = []
    summaries = {}
    for tier in scenes.tiers:
        of_tier = list(islice(cases, scenes.seeds))
        results += of_tier
        summaries[tier] = grasps.summarise_grasps(of_tier)
        for row in tables.grasp_rows({tier: summaries[tier]}):
            emit(row)
        done.report(f"tier {tier} is done")
    return {
        "grasps": {tier: {name: asdict(summary) for name, summary in of.items()} for tier, of in summaries.items()},
        "grasp_cases": [grasps.grasp_case_json(case) for case in results],
    }


def _views(scenes: SceneSet, progress: Progress, emit: Emit) -> dict[str, Any]:
    """Compare views as needed with eight views, with a message from time to time."""
    emit(tables.table_head(VIEWS_COLUMNS))
    done = SceneCount(VIEWS, scenes.count, progress)
    cases = run_views_cases(scenes.tiers, scenes.seeds, scenes.jobs, done.add, scenes.camera)
    results: list[ViewsCase] = []
    summaries = {}
    for tier in scenes.tiers:
        of_tier = list(islice(cases, scenes.seeds))
        results += [case for case in of_tier if case is not None]
        summaries[tier] = summarise_views(of_tier)
        emit(views_row(tier, summaries[tier]))
        done.report(f"tier {tier} is done")
    return {
        "views": {tier: asdict(summary) for tier, summary in summaries.items()},
        "views_cases": [asdict(case) for case in results],
    }


def _speed_json(speed: Speed, growth: Growth) -> dict[str, Any]:
    figures = asdict(speed)
    stages = figures.pop("stages")
    return {
        "speed": {name: round(value, 4) for name, value in figures.items()},
        "stages": {stage: round(seconds, 4) for stage, seconds in stages.items()},
        "growth": asdict(growth) | {"linear": growth.linear()},
    }


def _fail(reason: str) -> int:
    _log(reason)
    return 1


def _log(text: str) -> None:
    print(f"pointchain bench: {text}", file=sys.stderr, flush=True)
