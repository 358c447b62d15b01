"""Measure the time of recognition, from views in memory to the model, and its memory.

Everything is timed in a fresh process, after a warm-up run on a small scan that completes the late imports.
"""

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from cell.devices import View
from cell.simulation.benchmark.memory import current_rss_bytes, peak_rss_bytes
from cell.simulation.benchmark.worker_pool import in_fresh_process
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene

SCENE, SEED, CROSSINGS = "random", 2, 2
"""The scene that is timed, like the one of the paper: one string of 0.4 m, r = 4.2 mm."""
CAMERA = "oak-d-pro"
SMALL, LARGE, THUMBNAIL = (640, 400), (1280, 800), (320, 200)
RUNS = 7
"""Number of runs of a timing, of which the median counts."""
ENOUGH_S = 10.0
"""A timing ends when its runs have taken this long: slow timings scatter little."""
LITERAL_RUNS = 2
"""Number of runs of the literal baseline, of which the faster counts. It is slow."""
PAUSE_S = 0.1
"""Time between views that arrive one by one. An arm takes longer; this is enough to process a view."""


@dataclass(frozen=True, eq=False)
class Input:
    """Arguments of `recognise`."""

    views: tuple[View, ...]
    parameters: ChainParameters
    scene: Scene


@dataclass(frozen=True)
class Timing:
    """Time of one input."""

    seconds: float
    """Median of the runs."""
    stages: dict[str, float]
    """Median seconds of each stage."""
    points: int
    """Points of string height in all views, as the model reports them."""


@dataclass(frozen=True)
class Speed:
    """All timings, and their ratio."""

    views8_640x400_s: float
    literal_s: float
    ratio: float
    """Time of the literal baseline over that of `graph`."""
    after_last_view_s: float
    """Time from the last view to the model, when the views arrive one by one."""
    views8_1280x800_s: float
    peak_rss_mb: float
    """Peak resident memory of recognition with 8 views at 1280x800, beyond that of imports and views."""
    stages: dict[str, float]
    """Seconds of each stage at 640x400."""


def simulated_input(
    resolution: tuple[int, int],
    views: int = 8,
    scene: str = SCENE,
    seed: int = SEED,
    distance_m: float | None = None,
    **options: Any,
) -> Input:
    """Simulate the views of a scene by the timed camera.

    The camera is at `distance_m`, or as near as shows all of the scene when None. The options go to
    `cell.simulation.scenes.scenes.make_scene`.
    """
    from cell.simulation.offline_scan import simulate
    from cell.simulation.rendering.depth_camera import camera_model
    from cell.simulation.scenes.scenes import make_scene

    laid = make_scene(scene, seed, **options)
    camera = camera_model(CAMERA, resolution)
    if distance_m is not None:
        camera = replace(camera, working_m=(distance_m, distance_m))
    scan = simulate(laid, camera, seed, views=views)
    where = Scene(scan.header.table_z_m, scan.header.workspace_m)
    return Input(scan.views, ChainParameters.for_radius(laid.radius_m), where)


def measure_speed(say: Callable[[str], object]) -> Speed:
    """Measure all timings. `say` is called with a message on what is measured."""
    say("speed: simulating the scans")
    thumbnail, small, large = (simulated_input(size, crossings=CROSSINGS) for size in (THUMBNAIL, SMALL, LARGE))
    say("speed: 8 views at 640x400 and 1280x800")
    ours, ours_large = in_fresh_process(time_recognition, [small, large], thumbnail)
    say("speed: after the last view")
    after_last = in_fresh_process(time_after_last_view, small, thumbnail)
    say("speed: memory")
    peak = in_fresh_process(peak_memory_bytes, large, thumbnail)
    say("speed: the literal baseline")
    literal = in_fresh_process(time_literal, small, thumbnail)
    return Speed(
        views8_640x400_s=ours.seconds,
        literal_s=literal,
        ratio=literal / ours.seconds,
        after_last_view_s=after_last,
        views8_1280x800_s=ours_large.seconds,
        peak_rss_mb=peak / 2**20,
        stages=ours.stages,
    )


def time_recognition(inputs: Sequence[Input], thumbnail: Input, runs: int = RUNS) -> list[Timing]:
    """Time `recognise` with its default method on each input."""
    from recognition.pipeline import recognise

    recognise(thumbnail.views, thumbnail.parameters, thumbnail.scene)
    timings = []
    for given in inputs:
        seconds, stages, points = [], [], 0
        while not seconds or (len(seconds) < runs and sum(seconds) < ENOUGH_S):
            start = time.perf_counter()
            model = recognise(given.views, given.parameters, given.scene).model
            seconds.append(time.perf_counter() - start)
            stages.append(model.timing_s)
            points = sum(view.points for view in model.quality.views)
        by_stage = {stage: median(run[stage] for run in stages) for stage in stages[0]}
        timings.append(Timing(median(seconds), by_stage, points))
    return timings


def time_after_last_view(given: Input, thumbnail: Input, runs: int = RUNS, pause_s: float = PAUSE_S) -> float:
    """Return the median seconds from the last view to the model, when views arrive `pause_s` apart."""
    from recognition.pipeline import recognise

    handed_over = 0.0

    def arriving(views: Sequence[View]) -> Iterator[View]:
        nonlocal handed_over
        for view in views:
            time.sleep(pause_s)
            handed_over = time.perf_counter()
            yield view

    recognise(thumbnail.views, thumbnail.parameters, thumbnail.scene)
    seconds = []
    for _ in range(runs):
        recognise(arriving(given.views), given.parameters, given.scene)
        seconds.append(time.perf_counter() - handed_over)
    return median(seconds)


def time_literal(given: Input, thumbnail: Input, runs: int = LITERAL_RUNS) -> float:
    """Return the seconds of the fastest run of the literal baseline."""
    from cell.simulation.benchmark.reference import recognise_literally

    recognise_literally(thumbnail.views, thumbnail.parameters, thumbnail.scene)
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        recognise_literally(given.views, given.parameters, given.scene)
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def peak_memory_bytes(given: Input, thumbnail: Input) -> int:
    """Return the peak resident memory of `recognise`, beyond that of a process with the views and all imports.

    Memory that the process has freed before counts too, so that the figure is never too small.
    """
    from recognition.pipeline import recognise

    recognise(thumbnail.views, thumbnail.parameters, thumbnail.scene)
    # The pages of a copy become resident when they are first used.
    views = tuple(replace(view, depth=view.depth.copy()) for view in given.views)
    gc.collect()
    before = current_rss_bytes()
    recognise(views, given.parameters, given.scene)
    return max(peak_rss_bytes() - before, 0)
