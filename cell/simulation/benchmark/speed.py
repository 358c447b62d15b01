"""Measure the time and the memory of recognition, from views in memory to the model.

Each measurement runs in a fresh process. A warm-up run on a small scan comes first, because the first run also imports
modules.
"""

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.devices import View
from cell.simulation.benchmark.memory import current_rss_bytes, peak_rss_bytes
from cell.simulation.benchmark.worker_pool import run_in_fresh_process
from recognition.parameters import ChainParameters
from recognition.preprocessing.target_cloud import Scene
from recognition.request import RecognitionRequest

SCENE, SEED, CROSSINGS = "random", 2, 2
"""Name, seed and number of crossings of the timed scene. As in the paper, it has one string of 0.4 m, r = 4.2 mm."""
SMALL, LARGE, THUMBNAIL = (640, 400), (1280, 800), (320, 200)
"""Width and height of the depth images of the small and the large input, and of the warm-up."""
RUNS = 7
"""Maximum number of runs of a timing. The result is their median."""
MAX_TOTAL_S = 10.0
"""Total time of the runs after which a timing ends. Slow timings scatter little, so they need fewer runs."""
LITERAL_RUNS = 2
"""Number of runs of the literal baseline, which is slow. The result is the shortest time."""
PAUSE_S = 0.1
"""Time between views that arrive one by one, seconds. It suffices to process a view. A real arm takes longer."""


@dataclass(frozen=True, eq=False)
class Input:
    """Arguments of `recognise`."""

    views: tuple[View, ...]
    """Depth images with their camera poses."""
    radius_m: float
    """Radius of the strings, metres."""
    scene: Scene
    """Table height and workspace, base frame."""

    @property
    def request(self) -> RecognitionRequest:
        """Request for `recognise`."""
        return RecognitionRequest(radius_m=self.radius_m)


@dataclass(frozen=True)
class Timing:
    """Time of recognition for one input."""

    seconds: float
    """Median time of the runs."""
    stages: dict[str, float]
    """Median time of each stage, seconds."""
    points: int
    """Number of points above the table in all views."""


@dataclass(frozen=True)
class Speed:
    """Times and memory of recognition, and the time of the literal baseline."""

    views8_640x400_s: float
    """Time of recognition by the default method, for 8 views at 640x400."""
    literal_s: float
    """Time of the literal baseline, for 8 views at 640x400."""
    ratio: float
    """Ratio of `literal_s` to `views8_640x400_s`."""
    after_last_view_s: float
    """Time from the arrival of the last view to the model, when 8 views at 640x400 arrive one by one."""
    views8_1280x800_s: float
    """Time of recognition by the default method, for 8 views at 1280x800."""
    peak_rss_mb: float
    """Peak resident memory for 8 views at 1280x800, MiB. The memory of the imports and of the views is subtracted."""
    stages: dict[str, float]
    """Time of each stage for 8 views at 640x400, seconds."""


def simulated_input(
    resolution: tuple[int, int],
    views: int = 8,
    scene: str = SCENE,
    seed: int = SEED,
    distance_m: float | None = None,
    camera: CameraName = DEFAULT_CAMERA,
    **options: Any,
) -> Input:
    """Simulate the views of a scene.

    Args:
        resolution: Width and height of the depth images.
        views: Number of views.
        scene: Name of the scene.
        seed: Seed of the scene and of the scan.
        distance_m: Distance of the camera from the middle of the scene. None means the smallest distance
            within the working range of the camera from which each view shows the whole scene.
        camera: Camera that sees the scene.
        **options: Options of `cell.simulation.scenes.scenes.make_scene`.

    Returns:
        Arguments of `recognise`. The radius of the string is known.
    """
    from cell.simulation.offline_scan import simulate
    from cell.simulation.rendering.depth_camera import camera_model
    from cell.simulation.scenes.scenes import make_scene

    string_scene = make_scene(scene, seed, **options)
    model = camera_model(camera, resolution)
    if distance_m is not None:
        model = replace(model, working_m=(distance_m, distance_m))
    scan = simulate(string_scene, model, seed, views=views)
    table_scene = Scene(scan.header.table_z_m, scan.header.workspace_m)
    return Input(scan.views, string_scene.radius_m, table_scene)


def measure_speed(on_progress: Callable[[str], object], camera: CameraName = DEFAULT_CAMERA) -> Speed:
    """Measure all times and the memory.

    Args:
        on_progress: Called with a progress message before each measurement.
        camera: Camera that sees the scenes.
    """
    on_progress("speed: simulating the scans")
    sizes = (THUMBNAIL, SMALL, LARGE)
    thumbnail, small, large = (simulated_input(size, camera=camera, crossings=CROSSINGS) for size in sizes)
    on_progress("speed: 8 views at 640x400 and 1280x800")
    small_timing, large_timing = run_in_fresh_process(time_recognition, [small, large], thumbnail)
    on_progress("speed: after the last view")
    after_last = run_in_fresh_process(time_after_last_view, small, thumbnail)
    on_progress("speed: memory")
    peak = run_in_fresh_process(peak_memory_bytes, large, thumbnail)
    on_progress("speed: the literal baseline")
    literal = run_in_fresh_process(time_literal, small, thumbnail)
    return Speed(
        views8_640x400_s=small_timing.seconds,
        literal_s=literal,
        ratio=literal / small_timing.seconds,
        after_last_view_s=after_last,
        views8_1280x800_s=large_timing.seconds,
        peak_rss_mb=peak / 2**20,
        stages=small_timing.stages,
    )


def time_recognition(inputs: Sequence[Input], thumbnail: Input, runs: int = RUNS) -> list[Timing]:
    """Time `recognise` with its default method on each input.

    Args:
        inputs: Inputs to time.
        thumbnail: Input of the warm-up run.
        runs: Maximum number of runs of each input. The runs end earlier after `MAX_TOTAL_S`.

    Returns:
        Timing of each input.
    """
    from recognition.pipeline import recognise

    recognise(thumbnail.views, thumbnail.request, thumbnail.scene)
    timings = []
    for given in inputs:
        seconds, stages, points = [], [], 0
        while not seconds or (len(seconds) < runs and sum(seconds) < MAX_TOTAL_S):
            start = time.perf_counter()
            model = recognise(given.views, given.request, given.scene).model
            seconds.append(time.perf_counter() - start)
            stages.append(model.timing_s)
            points = sum(view.points for view in model.quality.views)
        by_stage = {stage: median(run[stage] for run in stages) for stage in stages[0]}
        timings.append(Timing(median(seconds), by_stage, points))
    return timings


def time_after_last_view(given: Input, thumbnail: Input, runs: int = RUNS, pause_s: float = PAUSE_S) -> float:
    """Time `recognise` from the arrival of the last view, when the views arrive one by one.

    Args:
        given: Input to time.
        thumbnail: Input of the warm-up run.
        runs: Number of runs.
        pause_s: Pause before each view, seconds.

    Returns:
        Median time from the arrival of the last view to the model, seconds.
    """
    from recognition.pipeline import recognise

    last_view_s = 0.0

    def delayed(views: Sequence[View]) -> Iterator[View]:
        nonlocal last_view_s
        for view in views:
            time.sleep(pause_s)
            last_view_s = time.perf_counter()
            yield view

    recognise(thumbnail.views, thumbnail.request, thumbnail.scene)
    seconds = []
    for _ in range(runs):
        recognise(delayed(given.views), given.request, given.scene)
        seconds.append(time.perf_counter() - last_view_s)
    return median(seconds)


def time_literal(given: Input, thumbnail: Input, runs: int = LITERAL_RUNS) -> float:
    """Time the literal baseline.

    Args:
        given: Input to time.
        thumbnail: Input of the warm-up run.
        runs: Number of runs.

    Returns:
        Shortest time of the runs, seconds.
    """
    from cell.simulation.benchmark.reference import recognise_literally

    def recognise(one: Input) -> None:
        recognise_literally(one.views, ChainParameters.for_radius(one.radius_m), one.scene)

    recognise(thumbnail)
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        recognise(given)
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def peak_memory_bytes(given: Input, thumbnail: Input) -> int:
    """Measure the peak resident memory of `recognise`.

    The peak is that of the whole process, so an earlier peak, such as that of the warm-up run, counts too.

    Args:
        given: Input to measure.
        thumbnail: Input of the warm-up run.

    Returns:
        Peak resident memory of this process, minus its resident memory before `recognise`, bytes.
    """
    from recognition.pipeline import recognise

    recognise(thumbnail.views, thumbnail.request, thumbnail.scene)
    # Copy the depth images, so that their pages are resident before the first reading.
    views = tuple(replace(view, depth=view.depth.copy()) for view in given.views)
    gc.collect()
    before = current_rss_bytes()
    recognise(views, given.request, given.scene)
    return max(peak_rss_bytes() - before, 0)
