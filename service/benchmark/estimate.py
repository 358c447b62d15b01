"""Estimate of the duration of `pointchain bench`, from a short probe on this machine.

The costs below are measured once, in units of the probe. A faster or busier machine changes the probe, not the costs.
Nothing heavy is imported here: the probe runs in worker processes that set their number of threads first.
"""

import heapq
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from cell.config.camera_names import DEFAULT_CAMERA, CameraName
from cell.simulation.benchmark.worker_pool import map_in_processes

PROBE_TIER, PROBE_SEED = "paper", 0
"""The probe simulates this case and recognises it by every method."""
PROBE_RUNS = 2
"""Number of timed runs of the probe in each process. One more run before them warms up."""
TIER_COSTS: Mapping[str, Sequence[float]] = {
    "paper": (1.1,),
    "long": (1.6,),
    "many": (2.0,),
    "physical": (1.7,),
    "soft": (1.0,),
    "photo": (4.2,),
    "hard": (3.3, 4.6, 2.1),
    "measured": (1.1, 1.6),
    "fixtures": (1.1, 1.4, 1.4, 1.2, 1.2),
    "tight": (3.0,),
    "ends": (1.6,),
    "branches": (1.7,),
    "mixed": (2.4,),
    "lifted": (1.5, 2.1),
    "clutter": (1.5,),
    "speckle": (1.1, 1.6),
    "side": (1.6,),
    "dense": (7.0,),
    "heap": (9.0,),
    "few": (0.5, 0.7, 0.8, 1.0),
    "noise": (1.5, 2.0),
    "thin": (3.0,),
}
"""Time of one scene of each tier, in units of the probe, with the camera `ideal`. Scenes of a tier with several kinds
take them in turn. With rendered images, the tiers differ less."""
GRASP_COSTS: Mapping[str, float] = {
    "paper": 17.0,
    "long": 20.0,
    "many": 20.0,
    "physical": 20.0,
    "soft": 24.0,
    "photo": 15.0,
    "hard": 20.0,
    "measured": 18.0,
    "fixtures": 18.0,
    "tight": 20.0,
    "ends": 20.0,
    "branches": 20.0,
    "mixed": 20.0,
    "lifted": 18.0,
    "clutter": 18.0,
    "speckle": 18.0,
    "side": 18.0,
    "dense": 18.0,
    "heap": 18.0,
    "few": 18.0,
    "noise": 18.0,
    "thin": 18.0,
}
"""Time of the simulated grasps of one scene of each tier, in units of the probe."""
VIEWS_COSTS: Mapping[str, float] = {
    "paper": 1.0,
    "long": 1.0,
    "many": 1.0,
    "physical": 0.9,
    "soft": 0.8,
    "photo": 0.6,
    "hard": 3.7,
    "fixtures": 0.8,
}
"""Time of both scans of one scene of each tier, in units of the probe."""
SPEED_STARTS, SPEED_PROBES = 7, 45.0
"""The speed part starts this many processes, and computes for this many probes."""
CELL_PACED_S, CELL_PROBES = 135.0, 10.0
"""The cell part waits this long for the simulated arm and camera, and computes for this many probes."""
SERVICE_PACED_S, SERVICE_PROBES = 410.0, 25.0
"""The service part waits and computes for this long."""
MAX_ELAPSED_SHARE = 0.95
"""Share of the work that counts as done if a part takes longer than estimated."""


@dataclass(frozen=True)
class Probe:
    """Times of the probe on this machine."""

    start_s: float
    """Time that a process takes to start, to import all modules and to warm up."""
    case_s: float
    """Time of the probe in a process that has started, while the requested number of processes run it at once."""


def measure_probe(processes: int, camera: CameraName = DEFAULT_CAMERA) -> Probe:
    """Run the probe in `processes` processes at once and return its times. Takes some seconds."""
    began_s = time.monotonic()
    case_s = list(map_in_processes(partial(probe_case, camera=camera), range(processes), processes))
    mean_s = sum(case_s) / len(case_s)
    return Probe(start_s=max(time.monotonic() - began_s - PROBE_RUNS * mean_s, 0.0), case_s=mean_s)


def probe_case(_: int, camera: CameraName = DEFAULT_CAMERA) -> float:
    """Return the mean seconds of the probe in this process, after one run to warm up."""
    from cell.simulation.benchmark.accuracy import run_case

    run_case((PROBE_TIER, PROBE_SEED), camera)
    began_s = time.monotonic()
    for _ in range(PROBE_RUNS):
        run_case((PROBE_TIER, PROBE_SEED), camera)
    return (time.monotonic() - began_s) / PROBE_RUNS


def scene_cost(tier: str, seed: int) -> float:
    """Return the expected time of one scene, in units of the probe."""
    costs = TIER_COSTS[tier]
    return costs[seed % len(costs)]


def accuracy_s(tiers: Sequence[str], seeds: int, jobs: int, probe: Probe) -> float:
    """Return the expected seconds of the accuracy part.

    Args:
        tiers: Names of tiers.
        seeds: Number of scenes of each tier.
        jobs: Number of processes.
        probe: Times of `min(jobs, scenes)` processes at once.
    """
    return _elapsed_s([scene_cost(tier, seed) for tier in tiers for seed in range(seeds)], jobs, probe)


def grasps_s(tiers: Sequence[str], seeds: int, jobs: int, probe: Probe) -> float:
    """Return the expected seconds of the part on grasps. The arguments are as for `accuracy_s`."""
    return _elapsed_s([GRASP_COSTS[tier] for tier in tiers for _ in range(seeds)], jobs, probe)


def views_s(tiers: Sequence[str], seeds: int, jobs: int, probe: Probe) -> float:
    """Return the expected seconds of the part on views. The arguments are as for `accuracy_s`."""
    return _elapsed_s([VIEWS_COSTS[tier] for tier in tiers for _ in range(seeds)], jobs, probe)


def _elapsed_s(costs: Iterable[float], jobs: int, probe: Probe) -> float:
    """Return the seconds until `jobs` processes have done all scenes, which cost `costs` in units of the probe.

    Each process takes the next scene as soon as it is free, so processes may be idle during the last scenes.
    """
    free_at_s = [probe.start_s] * jobs
    for cost in costs:
        heapq.heapreplace(free_at_s, free_at_s[0] + cost * probe.case_s)
    return max(free_at_s)


def speed_s(probe: Probe) -> float:
    """Return the expected seconds of the speed part, from the probe of one process."""
    return SPEED_STARTS * probe.start_s + SPEED_PROBES * probe.case_s


def cell_s(probe: Probe) -> float:
    """Return the expected seconds of the cell part, from the probe of one process."""
    return CELL_PACED_S + CELL_PROBES * probe.case_s


def service_s(probe: Probe) -> float:
    """Return the expected seconds of the service part, from the probe of one process."""
    return SERVICE_PACED_S + SERVICE_PROBES * probe.case_s


def remaining_s(estimate_s: float, elapsed_s: float, share_done: float | None = None) -> float:
    """Return the seconds that a part still needs.

    The more of the part is done, the more its own pace counts, and the less the estimate.

    Args:
        estimate_s: Estimate of the whole part, made before it began.
        elapsed_s: Time since the part began.
        share_done: Share of the work that is done, 0 to 1. None: it is unknown and estimated from the elapsed time.
    """
    if share_done is None:
        share_done = min(elapsed_s / estimate_s, MAX_ELAPSED_SHARE) if estimate_s > 0 else MAX_ELAPSED_SHARE
    return (1.0 - share_done) * ((1.0 - share_done) * estimate_s + elapsed_s)


def duration(seconds: float) -> str:
    """Return a duration for people: "40 s", or "3 min" from three minutes on."""
    return f"{seconds / 60:.0f} min" if seconds >= 180 else f"{seconds:.0f} s"
