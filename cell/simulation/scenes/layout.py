"""Layout of the strings of a scene on the table: courses, radii, and the upper strand of each crossing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cell.simulation.scenes import contacts, shapes
from cell.simulation.scenes.planar_crossings import PlanCrossing, plan_crossings
from cell.simulation.scenes.random_walk import CourseSettings, wander
from cell.simulation.scenes.shapes import Plan
from cell.simulation.scenes.strand_clearance import CROSSING_CLEARANCE

_MIXED_DRAWS = 30
"""Number of courses that are tried for strings of which two must cross."""


class SceneError(ValueError):
    """The scene does not exist, or cannot be made as requested."""

    slug = "scene"


@dataclass(frozen=True)
class SceneRequest:
    """Requested properties of a scene. None leaves a property to the seed."""

    name: str
    radius_m: float
    length_m: float
    softness: float
    crossings: int | None
    strings: int | None
    clearance: float


@dataclass(frozen=True, eq=False)
class Draft:
    """Strings on the table before their heights are computed."""

    plan: list[Plan]
    """Courses (N, 2) in even steps."""
    lengths_m: list[float]
    radii_m: list[float]
    crossings: int | None = None
    """Required number of crossings, if the course does not determine it."""
    touching: bool = False
    """Whether strands may touch other strands, or end beside them."""
    from_start: bool = False
    """Whether strings keep their first points, so that the length for the heights is cut from their other ends."""


def draft(rng: np.random.Generator, request: SceneRequest) -> Draft:
    """Return random courses with the requested properties.

    Raises:
        SceneError: None was found.
    """
    match request.name:
        case "several" | "random" | "settled":
            return _wandering(rng, request)
        case "tangle":
            return _tangle(rng, request)
        case "bar" | "plate" | "post" | "slot" | "wall":
            return _gentle(rng, request)
        case "mixed-radii":
            return _mixed(rng, request)
        case "ring" | "long" | "stacked" | "side-by-side" | "end-on-strand":
            return _arranged(rng, request)
    return _alone(_shape(rng, request), request)


def _shape(rng: np.random.Generator, request: SceneRequest) -> Plan:
    """Return one string of a named shape."""
    match request.name:
        case "straight":
            return shapes.straight(rng, request.length_m)
        case "arc":
            return shapes.arc(rng, request.length_m)
        case "loop":
            return shapes.loop(rng, request.length_m)
        case "figure-eight":
            return shapes.figure_eight(rng, request.length_m)
        case "overhand-knot":
            return shapes.overhand_knot(rng, request.length_m)
        case "coil":
            return shapes.coil(rng, request.length_m, 2 if request.crossings is None else request.crossings)
    raise SceneError(f"there is no scene {request.name!r}")


def _arranged(rng: np.random.Generator, request: SceneRequest) -> Draft:
    """Return several strings of a named arrangement, which determines the number of crossings."""
    radius_m, length_m = request.radius_m, request.length_m
    match request.name:
        case "ring":
            crossings = int(rng.integers(2)) if request.crossings is None else request.crossings
            return _alone(shapes.ring(rng, length_m, crossings), request, crossings)
        case "long":
            return _alone(shapes.spiral(rng, length_m, 6 * radius_m), request, 0)
        case "stacked":
            plan, crossings = contacts.stack(rng, length_m, radius_m), 3
        case "side-by-side":
            strings = int(rng.integers(1, 3)) if request.strings is None else request.strings
            plan, crossings = (contacts.hairpin if strings == 1 else contacts.pair)(rng, length_m, radius_m), 0
        case _:
            crossings = int(rng.integers(2)) if request.crossings is None else request.crossings
            plan = contacts.end_on_strand(rng, length_m, radius_m, bool(crossings))
    laid_end = request.name == "end-on-strand"
    return Draft(plan, [length_m] * len(plan), [radius_m] * len(plan), crossings, touching=True, from_start=laid_end)


def _alone(course: Plan, request: SceneRequest, crossings: int | None = None) -> Draft:
    return Draft([course], [request.length_m], [request.radius_m], crossings)


def choose_over(name: str, rng: np.random.Generator, crossings: Sequence[PlanCrossing]) -> list[bool]:
    """Return for each crossing whether its first strand is the upper one."""
    match name:
        case "coil":
            return [False] * len(crossings)
        case "overhand-knot":
            # over and under alternate; the two passes of a crossing differ by an odd number, so the first pass decides
            passes = sorted(position for x in crossings for position in (x.first, x.second))
            start = int(rng.integers(2))
            return [(passes.index(x.first) + start) % 2 == 0 for x in crossings]
        case "stacked":
            # three strands that are cyclically over each other would have to be woven
            level = rng.permutation(3)
            return [bool(level[x.first[0]] > level[x.second[0]]) for x in crossings]
        case "end-on-strand":
            return [False] * len(crossings)
    return [bool(rng.integers(2)) for _ in crossings]


def _wandering(rng: np.random.Generator, request: SceneRequest) -> Draft:
    """Return one or several strings with the requested number of crossings."""
    several = request.name == "several"
    strings = (int(rng.integers(2, 4)) if several else 1) if request.strings is None else request.strings
    most = (1, 5) if several else (0, 3)
    crossings = int(rng.integers(*most)) if request.crossings is None else request.crossings
    return _wander(
        rng, request, [request.length_m] * strings, CourseSettings(request.radius_m, request.clearance), crossings
    )


def _tangle(rng: np.random.Generator, request: SceneRequest) -> Draft:
    """Return cables of different lengths, gently curved with a few tight bends, some of them side by side.

    They cross at angles down to 25 degrees.
    """
    strings = int(rng.integers(1, 4)) if request.strings is None else request.strings
    most = min(3 * strings + 1, int(strings * request.length_m / (50 * request.radius_m)))
    crossings = int(rng.integers(min(most, 1), most + 1)) if request.crossings is None else request.crossings
    shares = rng.uniform(0.6, 1.4, strings) if strings > 1 else np.ones(1)
    lengths_m = [float(length_m) for length_m in request.length_m * strings * shares / shares.sum()]
    settings = CourseSettings(
        request.radius_m,
        min(request.clearance, 2.6),
        bend_radius=float(rng.uniform(5.0, 9.0)),
        bends_per_m=12.0,
        gentleness=2.0,
        min_angle_rad=float(np.deg2rad(25.0)),
    )
    return _wander(rng, request, lengths_m, settings, crossings)


def _gentle(rng: np.random.Generator, request: SceneRequest) -> Draft:
    """Return a gently curved string with at most one crossing, beside which a straight object has room."""
    crossings = int(rng.integers(2)) if request.crossings is None else request.crossings
    settings = CourseSettings(
        request.radius_m,
        request.clearance,
        bend_radius=min(float(rng.uniform(5.0, 9.0)), 0.075 * request.length_m / request.radius_m),
        bends_per_m=12.0,
        gentleness=2.0,
    )
    return _wander(rng, request, [request.length_m], settings, crossings)


def _mixed(rng: np.random.Generator, request: SceneRequest) -> Draft:
    """Return thick and thin strings that cross, with the requested radius and 0.55 to 0.75 of it, in random order."""
    strings = 2 if request.strings is None else request.strings
    crossings = int(rng.integers(1, strings + 1)) if request.crossings is None else request.crossings
    shares = np.concatenate([[1.0], rng.uniform(0.55, 0.75, strings - 1)])
    lengths_m = [request.length_m] * strings
    for _ in range(_MIXED_DRAWS):
        laid = _wander(rng, request, lengths_m, CourseSettings(request.radius_m, request.clearance), crossings)
        if not crossings or any(x.first[0] != x.second[0] for x in plan_crossings(laid.plan)):
            break
    else:
        raise SceneError(f"{request.name}: no two strings cross; use longer strings")
    return Draft(laid.plan, lengths_m, [float(request.radius_m * share) for share in rng.permutation(shares)])


def _wander(
    rng: np.random.Generator, request: SceneRequest, lengths_m: list[float], settings: CourseSettings, crossings: int
) -> Draft:
    count = len(lengths_m)
    # distance along a string between the two passes of crossings, and from its ends
    if sum(lengths_m) < CROSSING_CLEARANCE * settings.radius_m * (2 * crossings + count):
        plan = None
    else:
        plan = wander(rng, lengths_m, settings, crossings)
    if plan is None:
        raise SceneError(
            f"{request.name}: could not lay {count} string(s) of {request.length_m:g} m and radius "
            f"{request.radius_m:g} m with {crossings} crossings; use longer strings for more crossings, thinner or "
            "shorter ones for fewer"
        )
    return Draft(plan, lengths_m, [settings.radius_m] * count)
