"""Simulate the grasps of models of each tier on the true scenes, with and without errors of the robot."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.simulation.benchmark.intervals import Interval, clustered_interval
from cell.simulation.benchmark.worker_pool import map_in_processes
from cell.simulation.grasp_physics.judgement import JudgedGrasp, judge_grasps
from cell.simulation.grasp_physics.settings import robot_errors
from recognition.grasping.gripper import Gripper

TOP = 5
"""Number of the best grasps that are simulated with errors of the robot."""
MAX_SIMULATED = 20
"""Number of grasps of a scene that are simulated: the best `TOP`, and others spread evenly over the ranks."""
SELECTIONS: Mapping[str, int | None] = {"best": 1, f"top {TOP}": TOP, "all": None}
"""Number of the best grasps in each selection. None: all that are simulated."""


@dataclass(frozen=True)
class GraspResult:
    """Result of one grasp."""

    rank: int
    """Rank in the model, 0 for the best."""
    clean: bool
    """Whether the swept gripper keeps clear of the true scene, by exact geometry."""
    good: bool | None
    """Whether the grasp lifts the right string and nothing else. None: not simulated."""
    wrong_string: bool | None
    """Whether another strand is between the fingers after the lift. None: not simulated."""
    touching: bool | None
    """Whether the gripper touches anything but the gripped strand before it closes. None: not simulated."""
    failing_errors: tuple[str, ...] | None
    """Errors of the robot with which the grasp is not good. None: not simulated with errors."""
    wrong_string_with_errors: bool | None
    """Whether another strand is between the fingers with any of the errors. None: not simulated with errors."""
    touching_with_errors: bool | None
    """Whether the gripper touches anything but the gripped strand with any of the errors. None: not simulated."""


@dataclass(frozen=True)
class GraspCase:
    """Results of the grasps of one case."""

    tier: str
    """Name of the tier."""
    seed: int
    """Seed of the case."""
    refused: str | None
    """Slug and message if recognition refused the case, or None."""
    grasps: tuple[GraspResult, ...] = ()
    """All grasps of the model, the best first."""


@dataclass(frozen=True)
class GraspSummary:
    """Shares of the grasps of one selection in one tier, 0 to 1. A share is None without a grasp."""

    scenes: int
    """Number of scenes with a grasp."""
    without_grasp: int
    """Number of scenes without a grasp, or that recognition refused."""
    simulated: int
    """Number of simulated grasps."""
    good: float | None
    """Share of the simulated grasps that lift the right string and nothing else."""
    good_interval_95: Interval | None
    """95 % confidence interval of `good`. The grasps of one scene are not independent."""
    wrong_string: float | None
    """Share with another strand between the fingers."""
    touching: float | None
    """Share that touches anything but the gripped strand before closing."""
    clean: float | None
    """Share of all grasps, simulated or not, whose approach is clean by geometry."""
    with_errors: int
    """Number of grasps that are simulated with errors of the robot."""
    good_with_errors: float | None
    """Share of these that are good with each of the errors."""
    wrong_string_with_errors: float | None
    """Share of these with another strand between the fingers with any of the errors."""
    touching_with_errors: float | None
    """Share of these that touch anything but the gripped strand with any of the errors."""


def run_grasp_case(tier_and_seed: tuple[str, int], camera: CameraName = DEFAULT_CAMERA) -> GraspCase:
    """Simulate the scan of a case, recognise it by `graph`, and judge its grasps for the default gripper.

    Args:
        tier_and_seed: Name of the tier and seed of the case.
        camera: Camera that sees the scene.
    """
    from cell.simulation.cases import make_case, simulate
    from recognition.errors import RecognitionError
    from recognition.pipeline import recognise
    from recognition.preprocessing.target_cloud import Scene
    from recognition.request import RecognitionRequest

    tier, seed = tier_and_seed
    case = make_case(tier, seed, camera)
    scan = simulate(case)
    scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    try:
        model = recognise(scan.views, RecognitionRequest(radius_m=scan.truth["radius"]), scene).model
        judged = judge_grasps(
            case.scene,
            model.chains,
            model.grasps,
            Gripper(),
            simulated=simulated_ranks(len(model.grasps)),
            errors=robot_errors(),
            with_errors=range(min(TOP, len(model.grasps))),
        )
    except RecognitionError as error:
        return GraspCase(tier, seed, f"{error.slug}: {error}")
    except Exception as error:
        error.add_note(f"while grasping in {tier}, seed {seed}")
        raise
    return GraspCase(tier, seed, None, tuple(map(_result, judged)))


def simulated_ranks(count: int) -> list[int]:
    """Return the ranks that are simulated of `count` grasps: the best `TOP`, and others spread over the rest."""
    if count <= MAX_SIMULATED:
        return list(range(count))
    return [*range(TOP), *np.linspace(TOP, count - 1, MAX_SIMULATED - TOP).round().astype(int).tolist()]


def run_grasp_cases(
    tiers: Sequence[str],
    seeds: int,
    jobs: int,
    on_done: Callable[[str], object] | None = None,
    camera: CameraName = DEFAULT_CAMERA,
) -> Iterator[GraspCase]:
    """Yield the results of all cases, tier by tier and by seed.

    Args:
        tiers: Names of the tiers.
        seeds: Number of cases of each tier. Their seeds are 0, 1, ...
        jobs: Number of processes.
        on_done: Function that is called with the tier of each case before its result is yielded.
        camera: Camera that sees the scenes.
    """
    items = [(tier, seed) for tier in tiers for seed in range(seeds)]
    for case in map_in_processes(partial(run_grasp_case, camera=camera), items, jobs):
        if on_done is not None:
            on_done(case.tier)
        yield case


def summarise_grasps(cases: Sequence[GraspCase]) -> dict[str, GraspSummary]:
    """Summarise the cases of one tier, by selection."""
    return {name: _summarise(cases, count) for name, count in SELECTIONS.items()}


def grasp_case_json(case: GraspCase) -> dict[str, Any]:
    """Return the results of a case as JSON."""
    return asdict(case)


def _result(judged: JudgedGrasp) -> GraspResult:
    """Return the result of a grasp. A grasp of a chain that matches no string is not good."""
    clean = judged.clearance is not None and judged.clearance.is_clean
    if judged.planned is None:
        return GraspResult(judged.rank, clean, False, False, False, None, None, None)
    outcome, others = judged.outcome, [outcome for _, outcome in judged.with_errors]
    return GraspResult(
        rank=judged.rank,
        clean=clean,
        good=None if outcome is None else outcome.good,
        wrong_string=None if outcome is None else outcome.wrong_string,
        touching=None if outcome is None else outcome.touches_more(),
        failing_errors=tuple(error.name for error, found in judged.with_errors if not found.good) if others else None,
        wrong_string_with_errors=any(found.wrong_string for found in others) if others else None,
        touching_with_errors=any(found.touches_more() for found in others) if others else None,
    )


def _summarise(cases: Sequence[GraspCase], count: int | None) -> GraspSummary:
    chosen = [case.grasps[:count] for case in cases if case.grasps]
    simulated = [[grasp for grasp in grasps if grasp.good is not None] for grasps in chosen]
    flat = [grasp for grasps in simulated for grasp in grasps]
    disturbed = [grasp for grasp in flat if grasp.failing_errors is not None]
    return GraspSummary(
        scenes=len(chosen),
        without_grasp=len(cases) - len(chosen),
        simulated=len(flat),
        good=_share(grasp.good for grasp in flat),
        good_interval_95=clustered_interval(
            [sum(bool(grasp.good) for grasp in grasps) for grasps in simulated], [len(grasps) for grasps in simulated]
        ),
        wrong_string=_share(grasp.wrong_string for grasp in flat),
        touching=_share(grasp.touching for grasp in flat),
        clean=_share(grasp.clean for grasps in chosen for grasp in grasps),
        with_errors=len(disturbed),
        good_with_errors=_share(bool(grasp.good) and not grasp.failing_errors for grasp in disturbed),
        wrong_string_with_errors=_share(grasp.wrong_string_with_errors for grasp in disturbed),
        touching_with_errors=_share(grasp.touching_with_errors for grasp in disturbed),
    )


def _share(values: Iterable[bool | None]) -> float | None:
    flags = [bool(value) for value in values]
    return round(float(np.mean(flags)), 4) if flags else None
