"""Tier `tight`: knots that are pulled tight, between free tails on the table."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.planar_crossings import plan_crossings
from cell.simulation.scenes.scenes import SceneError, StringScene
from cell.simulation.scenes.shapes import STEP_M, rotated
from cell.simulation.scenes.stacking_heights import HeightsError, lay
from cell.simulation.scenes.strand_clearance import deepest_overlap
from cell.simulation.string_physics.knot_tightening import core_range, tighten
from recognition.geometry.polyline import resample

KNOTS: Mapping[str, tuple[float, float]] = {
    "overhand": (6.3, 12.0),
    "figure-eight": (7.8, 12.0),
    "square": (7.3, 12.0),
}
"""Sizes to which each knot is tightened, radii, as `core_size` measures them."""
TAIL_M = (0.08, 0.15)
"""Length of each tail, from the core of the knot."""

_PLAN_STEP = 0.25
_TAIL_BEND_RADII = 25.0
"""Smallest bend radius of the tails."""
_MAX_OVERLAP = 0.05
"""Largest overlap of strands, relative to their diameter."""

Points = NDArray[np.float64]


def draw_knots(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw the case of the tier `tight`. The seeds take the three knots in turn.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene.

    Raises:
        SceneError: The drawn knot cannot be tightened, or its tails meet.
    """
    kind = tuple(KNOTS)[seed % len(KNOTS)]
    radius_m = float(rng.choice([0.003, 0.004, 0.005]))
    scene = tight_knot(rng, kind, float(rng.uniform(*KNOTS[kind])), radius_m, f"tight-{kind}-{seed}")
    return Case(tier, seed, scene, camera_model("ideal"), PoseErrors())


def tight_knot(rng: np.random.Generator, kind: str, size: float, radius_m: float, name: str) -> StringScene:
    """Return a scene with a knot on the table.

    Args:
        rng: Generator of the tails, of the mirror image, and of the direction.
        kind: One of `KNOTS`. A square knot joins two strings, the others are in one string.
        size: Size of the core, radii.
        radius_m: Radius of the strings.
        name: Name of the scene.

    Raises:
        SceneError: The knot cannot be tightened to this size, or its tails meet.
    """
    plans, over, pulls = loose_knot(rng, kind)
    found = plan_crossings(plans)
    try:
        heights = lay(plans, found, over, (1.0,) * len(plans), 1.05)
    except HeightsError as error:
        raise SceneError(str(error)) from error
    tight = tighten([np.column_stack([xy, z]) for xy, z in zip(plans, heights, strict=True)], pulls, size)
    core = core_range(tight)
    assert core is not None
    curves = [_with_tails(rng, curve, span, radius_m) for curve, span in zip(tight, core, strict=True)]
    mirror, angle = np.array([rng.choice([-1.0, 1.0]), 1.0]), float(rng.uniform(0, 2 * np.pi))
    curves = [np.column_stack([rotated(curve[:, :2] * mirror, angle), curve[:, 2]]) for curve in curves]
    if len(plan_crossings(curves)) != len(plan_crossings(tight)):
        raise SceneError("the tails of the knot cross")
    if deepest_overlap(curves, (radius_m,) * len(curves)) > _MAX_OVERLAP:
        raise SceneError("the tails of the knot touch")
    plan = np.vstack(curves)[:, :2]
    middle = (plan.min(axis=0) + plan.max(axis=0)) / 2
    return StringScene(name, radius_m, tuple(curve - [*middle, 0.0] for curve in curves))


def loose_knot(rng: np.random.Generator, kind: str) -> tuple[list[Points], list[bool], list[Points]]:
    """Return a loose knot: its courses (N, 2), over and under, and the pulls at its ends.

    Lengths are in radii. Over and under say for each of the crossings by `plan_crossings` whether its first strand is
    the upper one. The pulls are unit directions (2, 2) of the ends of each course.
    """
    courses, directions = _DIAGRAMS[kind]()
    plans = [resample(course, _PLAN_STEP) for course in courses]
    found = plan_crossings(plans)
    if kind == "square":
        over = [True, False, True, True, False, True]
    else:
        # Over and under alternate along the string. The two passes of a crossing are an odd number apart.
        passes = sorted(position for x in found for _, position in (x.first, x.second))
        over = [passes.index(x.first[1]) % 2 == 0 for x in found]
    spread = rng.uniform(-0.25, 0.25, len(directions))
    pulls = [np.array([np.cos(a), np.sin(a)]) for a in np.array(directions) + spread]
    return plans, over, [np.array(pulls[2 * k : 2 * k + 2]) for k in range(len(plans))]


def _overhand() -> tuple[list[Points], list[float]]:
    """Return a trefoil that is cut open in one lobe, and the directions of its ends."""
    t = np.linspace(0.35, 2 * np.pi - 0.35, 2000) + np.pi
    trefoil = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)])
    return [4.0 * trefoil], _apart(trefoil)


def _figure_eight() -> tuple[list[Points], list[float]]:
    """Return a figure-eight knot that is cut open in one of its two outer arcs, and the directions of its ends."""
    t = np.linspace(0.5, 2 * np.pi - 0.5, 2000)
    far = 2 + np.cos(2 * t)
    knot = far[:, None] * np.column_stack([np.cos(3 * t), np.sin(3 * t)])
    return [4.5 * knot], _apart(knot)


def _square() -> tuple[list[Points], list[float]]:
    """Return two strings in a square knot, and the directions of their ends."""
    first = [(-14, 2.5), (-6, 2.0), (0, 2.0), (4, 1.8), (5.5, 0.0), (4, -1.8), (0, -2.0), (-6, -2.0), (-14, -2.5)]
    half = [(14, 1.2), (6, 0.9), (2.5, 0.9), (0.8, 2.2), (-0.8, 4.2), (-3.0, 4.2), (-4.0, 2.0), (-4.2, 0.0)]
    second = half + [(x, -y) for x, y in half[-2::-1]]
    return [2.2 * _smooth(first), 2.2 * _smooth(second)], [np.pi - 0.45, np.pi + 0.45, 0.45, -0.45]


_DIAGRAMS: Mapping[str, Callable[[], tuple[list[Points], list[float]]]] = {
    "overhand": _overhand,
    "figure-eight": _figure_eight,
    "square": _square,
}


def _apart(course: Points) -> list[float]:
    """Return opposite directions for the ends of a course, along the line through both."""
    x, y = course[0] - course[-1]
    return [float(np.arctan2(y, x)), float(np.arctan2(-y, -x))]


def _smooth(points: Sequence[tuple[float, float]]) -> Points:
    """Return a smooth course through some points."""
    from scipy.interpolate import CubicSpline

    knots = np.array(points, dtype=np.float64)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    return CubicSpline(s, knots)(np.linspace(0.0, s[-1], 2000))


def _with_tails(rng: np.random.Generator, curve: Points, core: tuple[float, float], radius_m: float) -> Points:
    """Return a curve (N, 3), metres, in even steps, with tails on the table that bend at a constant rate."""
    from scipy.interpolate import CubicSpline

    points = _tailed(rng, curve, int(core[1]), radius_m)
    points = _tailed(rng, points[::-1], len(points) - 1 - int(core[0]), radius_m)
    points = points[::-1] * radius_m
    t = np.arange(len(points))
    fine = resample(CubicSpline(t, points)(np.linspace(0, t[-1], 20 * len(t))), STEP_M)
    fine[:, 2] = np.maximum(fine[:, 2], radius_m)
    return fine


def _tailed(rng: np.random.Generator, points: Points, inner: int, radius_m: float) -> Points:
    """Return `points` (N, 3), radii, with a tail instead of the part that lies on the table after point `inner`."""
    low = np.nonzero(points[inner:, 2] < 1.05)[0]
    last = max(inner + int(low[0]) if len(low) else len(points) - 1, min(inner + 4, len(points) - 1))
    step = float(np.linalg.norm(np.diff(points[: last + 1], axis=0), axis=1).mean())
    length = rng.uniform(*TAIL_M) / radius_m - step * (last - inner)
    turn = rng.uniform(-1, 1) / _TAIL_BEND_RADII
    x, y = points[last, :2] - points[last - 2, :2]
    heading = np.arctan2(y, x) + turn * step * np.arange(1, max(int(length / step), 1) + 1)
    tail = points[last, :2] + step * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    return np.vstack([points[: last + 1], np.column_stack([tail, np.ones(len(tail))])])
