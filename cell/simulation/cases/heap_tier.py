"""Tier `heap`: strings that fell onto the table in loose coils."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.planar_crossings import PlanCrossing, at, plan_crossings
from cell.simulation.scenes.scenes import SceneError, StringScene
from cell.simulation.scenes.strand_clearance import deepest_overlap, step_of
from cell.simulation.string_physics.heap_drop import MAX_OVERLAP, drop

RADIUS_M = (0.0025, 0.004)
"""Smallest and largest radius of the strings."""
MAX_STRINGS = 5
"""Largest number of strings."""
TOTAL_M = (1.5, 3.0)
"""Smallest and largest total length of the strings."""
CROSSINGS = (12, 40)
"""Smallest and largest number of crossings of a heap at rest."""
MIN_BEND_RADII = 4.0
"""Smallest bend radius of a string at rest, radii."""
MIN_ANGLE_RAD = float(np.deg2rad(8))
"""Smallest angle of a crossing. At smaller angles, strands lie along each other, and their crossing has no clear
position."""
MIN_END_RADII = 3.0
"""Smallest distance of a crossing from the end of a string, along the string, radii. An end nearer below a strand is
hidden, and so is whether it crosses. The tier `ends` has such ends."""
MAX_WIDTH_M = 0.36
"""Largest width of the coils, so that all views show the heap."""

_COIL_M = (0.045, 0.085)
"""Range of the mean bend radius of a string."""
_MIN_COIL_M = 0.035
"""Smallest bend radius before the fall."""
_BEND_SPREAD, _BEND_STEP_M = 0.8, 0.12
"""Standard deviation of the curvature along a string, relative to its mean, and the length over which it changes."""
_DRAWN_END_RADII, _DRAWN_ANGLE_RAD = 7.0, float(np.deg2rad(12))
"""`MIN_END_RADII` and `MIN_ANGLE_RAD` before the fall, which changes both a little."""
_OFFSET_M = 0.03
"""Largest distance of the middle of a string from the middle of the heap, in x and in y."""
_SLOPE = (0.03, 0.06)
"""Range of the slope of a string before the fall."""
_WAVE_M, _WAVE_LENGTH_M = 0.01, 0.25
"""Amplitude and length of the waves in the height of a string before the fall."""
_LOW_M, _START_M = 0.02, 0.04
"""Height of the lowest string above the table before the fall, and the range of the mean heights."""
_HANG_RADII = (15.0, 30.0)
"""Range of the bending stiffness, as `drop` takes it."""
_COURSES, _HEIGHTS = 500, 60
"""Maximum numbers of drawn courses, and of drawn heights for each course."""
_STEP_M = 0.002
_TRIMS = 4
"""Number of times that ends near crossings are cut. A cut end may lie near another crossing."""

Points = NDArray[np.float64]


def draw_heap(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw the case of the tier `heap`. The seeds take one to five strings in turn.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene.

    Raises:
        PhysicsError: MuJoCo is not installed.
        SceneError: The strings do not come to rest as a heap whose truth is defined.
    """
    radius_m = float(rng.uniform(*RADIUS_M))
    curves = drop(_coils(rng, seed % MAX_STRINGS + 1, radius_m), radius_m, float(rng.uniform(*_HANG_RADII)))
    found = plan_crossings(curves)
    if not CROSSINGS[0] <= len(found) <= CROSSINGS[1]:
        raise SceneError(f"the heap has {len(found)} crossings")
    if min(crossing.angle_rad for crossing in found) < MIN_ANGLE_RAD:
        raise SceneError("strands of the heap lie along each other")
    if min(_end_distances_m(curves, found)) < MIN_END_RADII * radius_m:
        raise SceneError("a string of the heap ends at a crossing")
    if min(tightest_bend_m(curve) for curve in curves) < MIN_BEND_RADII * radius_m:
        raise SceneError("bends of the heap are too tight")
    if deepest_overlap(curves, (radius_m,) * len(curves)) > MAX_OVERLAP / 2:
        raise SceneError("strands of the heap intersect")
    plan = np.vstack(curves)[:, :2]
    middle = (plan.min(axis=0) + plan.max(axis=0)) / 2
    scene = StringScene(f"heap-{seed}", radius_m, tuple(curve - [*middle, 0.0] for curve in curves))
    return Case(tier, seed, scene, camera_model("ideal", (800, 500)), PoseErrors())


def tightest_bend_m(curve: Points) -> float:
    """Return the smallest radius of curvature of a curve (N, 3) in steps of 1 mm, over 8 mm."""
    coarse = curve[::4]
    step = float(np.linalg.norm(np.diff(coarse, axis=0), axis=1).mean())
    bend = np.linalg.norm(np.diff(coarse, 2, axis=0), axis=1).max(initial=1e-12) / step**2
    return float(1 / bend)


def _end_distances_m(curves: Sequence[Points], found: Sequence[PlanCrossing]) -> list[float]:
    """Return the distances of both passes of each crossing from the nearer end of their string, along the string."""
    passes = [(curves[string], position) for x in found for string, position in (x.first, x.second)]
    return [min(position, len(curve) - 1 - position) * step_of(curve) for curve, position in passes]


def _coils(rng: np.random.Generator, count: int, radius_m: float) -> list[Points]:
    """Return centre lines (N, 3) of strings above the table that are apart."""
    for _ in range(_COURSES):
        length_m = float(rng.uniform(*TOTAL_M)) / count
        courses = [_course(rng, length_m) + rng.uniform(-_OFFSET_M, _OFFSET_M, 2) for _ in range(count)]
        courses = _trimmed(courses, _DRAWN_END_RADII * radius_m)
        found = plan_crossings(courses)
        if np.ptp(np.vstack(courses), axis=0).max() > MAX_WIDTH_M or not CROSSINGS[0] <= len(found) <= CROSSINGS[1]:
            continue
        if sum(map(len, courses)) * _STEP_M < TOTAL_M[0] or min(x.angle_rad for x in found) < _DRAWN_ANGLE_RAD:
            continue
        for _ in range(_HEIGHTS):
            heights = [_heights(rng, len(course)) for course in courses]
            if _smallest_gap(heights, found) > 2.4 * radius_m:
                low = min(float(z.min()) for z in heights) - _LOW_M - 2 * radius_m
                coils = [np.column_stack([xy, z - low]) for xy, z in zip(courses, heights, strict=True)]
                if deepest_overlap(coils, (radius_m,) * count) < 0:
                    return coils
    raise SceneError("no coils of the strings are apart")


def _trimmed(courses: Sequence[Points], clear_m: float) -> list[Points]:
    """Return the courses (N, 2), cut before each crossing that is nearer to an end than `clear_m`."""
    courses = list(courses)
    margin = int(clear_m / _STEP_M) + 2
    for _ in range(_TRIMS):
        first, last = [0] * len(courses), [len(course) for course in courses]
        for crossing in plan_crossings(courses):
            for string, position in (crossing.first, crossing.second):
                if position < margin:
                    first[string] = max(first[string], int(position) + margin)
                elif position > len(courses[string]) - 1 - margin:
                    last[string] = min(last[string], int(position) + 1 - margin)
        courses = [
            course[a:b] if b - a > 2 * margin else course for course, a, b in zip(courses, first, last, strict=True)
        ]
    return courses


def _course(rng: np.random.Generator, length_m: float) -> Points:
    """Return a course (N, 2) of smoothly varying curvature around the origin."""
    from scipy.interpolate import CubicSpline

    s = np.linspace(0.0, length_m, int(length_m / _STEP_M) + 1)
    knots = np.linspace(0.0, length_m, int(length_m / _BEND_STEP_M) + 2)
    mean = 1 / rng.uniform(*_COIL_M)
    bend = CubicSpline(knots, rng.normal(mean, _BEND_SPREAD * mean, len(knots)))(s)
    bend = rng.choice([-1.0, 1.0]) * np.clip(bend, -1 / _MIN_COIL_M, 1 / _MIN_COIL_M)
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(bend) * s[1]
    course = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0) * s[1]
    return course - (course.min(axis=0) + course.max(axis=0)) / 2


def _heights(rng: np.random.Generator, count: int) -> Points:
    """Return the heights (N,) along a string before the fall."""
    s = (np.arange(count) - count / 2) * _STEP_M
    wave = _WAVE_M * np.sin(2 * np.pi * s / _WAVE_LENGTH_M + rng.uniform(0, 2 * np.pi))
    return rng.uniform(0.0, _START_M) + rng.choice([-1.0, 1.0]) * rng.uniform(*_SLOPE) * s + wave


def _smallest_gap(heights: Sequence[Points], found: Sequence[PlanCrossing]) -> float:
    """Return the smallest difference of the heights at the crossings."""
    between = [
        at(heights[a][:, None], s)[0] - at(heights[b][:, None], t)[0]
        for (a, s), (b, t) in ((crossing.first, crossing.second) for crossing in found)
    ]
    return float(np.abs(between).min())
