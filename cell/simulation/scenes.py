"""String scenes: strings lying on a table, over and under one another."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cell.simulation import shapes
from cell.simulation.clearance import CROSSING_CLEARANCE, MIN_SIDE_CLEARANCE, SIDE_CLEARANCE, strands_apart
from cell.simulation.clutter import Box, place_boxes
from cell.simulation.crossings import PlanCrossing, plan_crossings
from cell.simulation.heights import HeightsError, lay
from cell.simulation.wander import wander
from recognition.model import arc_length


class SceneError(ValueError):
    """A scene that does not exist or can't be laid as wished."""

    slug = "scene"


@dataclass(frozen=True, eq=False)
class StringScene:
    """Strings on the table z = 0 of the base frame, about its origin."""

    name: str
    radius_m: float
    curves: tuple[NDArray[np.float64], ...]
    """Centre line of each string, (N, 3), in steps of about 1 mm; strings end square, without a cap."""
    boxes: tuple[Box, ...] = field(default=())
    """Clutter."""


SCENES = ("straight", "arc", "loop", "figure-eight", "overhand-knot", "coil", "several", "random")
"""The names that `make_scene` knows."""

MIN_BEND = 2.5
"""No string is bent tighter than this many radii: it would buckle."""

_DRAWS = 12
"""Drafts of a scene before it is given up."""


def make_scene(
    name: str,
    seed: int,
    radius_m: float = 0.0042,
    length_m: float = 0.4,
    softness: float = 1.0,
    crossings: int | None = None,
    clutter: int = 0,
    strings: int | None = None,
    clearance: float = SIDE_CLEARANCE,
) -> StringScene:
    """The scene of that name and seed; the same arguments give the same arrays.

    straight, arc: no crossing. loop, figure-eight: one. overhand-knot: three, alternating, of equal sign.
    coil: `crossings` turns (2 unless said), each over the one before. several: `strings` (2 or 3) strings
    with 1 to 4 crossings or as many as wished. random: one string (or `strings`) with 0 to 2 or as many as wished.

    Args:
        radius_m: of every string.
        length_m: of every string, along its centre line in space.
        softness: 1.0: centre lines are 2 r apart where strands cross; 0.6: pressed together to 0.6 of that.
        crossings: how many, for coil, several and random.
        clutter: number of boxes beside the strings.
        strings: how many, for several and random.
        clearance: least distance of strands that do not cross, in radii, for several and random; 2.4 lets them lie
            side by side all but touching.

    Raises:
        SceneError: an unknown name, values out of range, or no such scene can be laid.
    """
    _check(name, seed, radius_m, length_m, softness, crossings, clutter, strings, clearance)
    rng = np.random.default_rng([SCENES.index(name), seed])
    plan, heights = _lay(name, rng, radius_m, length_m, softness, crossings, strings, clearance)
    curves = tuple(_cut(np.column_stack([xy, z]), length_m) for xy, z in zip(plan, heights, strict=True))
    boxes = place_boxes(rng, curves, radius_m, clutter)
    if boxes is None:
        raise SceneError(f"{name}: there is no room for {clutter} boxes beside the strings; use fewer")
    return StringScene(f"{name}-{seed}", radius_m, curves, boxes)


def _lay(
    name: str,
    rng: np.random.Generator,
    radius_m: float,
    length_m: float,
    softness: float,
    crossings: int | None,
    strings: int | None,
    clearance: float,
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Courses (N, 2) and heights (N,) of the strings, drawn again where strands touch or can't pass one another."""
    reason = ""
    for _ in range(_DRAWS):
        plan = _plan(name, rng, radius_m, length_m, crossings, strings, clearance)
        found = plan_crossings(plan)
        if min(shapes.tightest_bend(curve) for curve in plan) < MIN_BEND * radius_m:
            reason = "bends get too tight"
            continue
        if not strands_apart(plan, found, MIN_SIDE_CLEARANCE * radius_m):
            reason = "strands touch side by side"
            continue
        try:
            return plan, lay(plan, found, _over(name, rng, found), radius_m, softness)
        except HeightsError as error:
            reason = str(error)
    raise SceneError(
        f"{name}: {reason} when a string of {length_m:g} m has a radius of {radius_m:g} m; "
        "use a longer or a thinner one"
    )


def _plan(
    name: str,
    rng: np.random.Generator,
    radius_m: float,
    length_m: float,
    crossings: int | None,
    strings: int | None,
    clearance: float,
) -> list[NDArray[np.float64]]:
    """The courses of the scene's strings on the table."""
    match name:
        case "straight":
            return [shapes.straight(rng, length_m)]
        case "arc":
            return [shapes.arc(rng, length_m)]
        case "loop":
            return [shapes.loop(rng, length_m)]
        case "figure-eight":
            return [shapes.figure_eight(rng, length_m)]
        case "overhand-knot":
            return [shapes.overhand_knot(rng, length_m)]
        case "coil":
            return [shapes.coil(rng, length_m, 2 if crossings is None else crossings)]
        case "several":
            count = int(rng.integers(2, 4)) if strings is None else strings
            wished = int(rng.integers(1, 5)) if crossings is None else crossings
        case _:
            count = 1 if strings is None else strings
            wished = int(rng.integers(3)) if crossings is None else crossings
    # Crossings' two passes, and strings' ends, keep this far apart along the strings.
    if count * length_m < CROSSING_CLEARANCE * radius_m * (2 * wished + count):
        plan = None
    else:
        plan = wander(rng, count, length_m, radius_m, wished, clearance)
    if plan is None:
        raise SceneError(
            f"{name}: found no way to lay {count} string(s) of {length_m:g} m and radius {radius_m:g} m with "
            f"{wished} crossings; use longer strings for more crossings, thinner or shorter ones for fewer"
        )
    return plan


def _over(name: str, rng: np.random.Generator, crossings: Sequence[PlanCrossing]) -> list[bool]:
    """For each crossing, whether its first strand lies above."""
    if name == "coil":
        return [False] * len(crossings)
    if name == "overhand-knot":
        # Passes alternate; a crossing's two passes are an odd number apart, so that its first decides.
        passes = sorted(position for x in crossings for position in (x.first, x.second))
        start = int(rng.integers(2))
        return [(passes.index(x.first) + start) % 2 == 0 for x in crossings]
    return [bool(rng.integers(2)) for _ in crossings]


def _cut(curve: NDArray[np.float64], length_m: float) -> NDArray[np.float64]:
    """`curve` (N, 3) cut at both ends to a length (lifting has made it longer), in even steps."""
    s = arc_length(curve)
    spare = (s[-1] - length_m) / 2
    even = np.linspace(spare, s[-1] - spare, int(np.ceil(length_m / shapes.STEP_M - 1e-9)) + 1)
    return np.column_stack([np.interp(even, s, curve[:, k]) for k in range(3)])


def _check(
    name: str,
    seed: int,
    radius_m: float,
    length_m: float,
    softness: float,
    crossings: int | None,
    clutter: int,
    strings: int | None,
    clearance: float,
) -> None:
    if name not in SCENES:
        raise SceneError(f"there is no scene {name!r}; known are {', '.join(SCENES)}")
    for what, value, low, high in (
        ("seed", seed, 0, 2**63),
        ("radius_m", radius_m, 0.0005, 0.02),
        ("length_m", length_m, 0.05, 12.0),
        ("softness", softness, 0.6, 1.0),
        ("clutter", clutter, 0, 20),
        ("crossings", 0 if crossings is None else crossings, 0, 40),
        ("strings", 1 if strings is None else strings, 1, 6),
        ("clearance", clearance, MIN_SIDE_CLEARANCE, 20.0),
    ):
        if not low <= value <= high:
            raise SceneError(f"{name}: {what} is {value!r}; from {low:g} to {high:g} is taken")
    if length_m < 12 * radius_m:
        raise SceneError(f"{name}: a string of {length_m:g} m is too short for a radius of {radius_m:g} m")
    if crossings is not None and name not in ("coil", "several", "random"):
        raise SceneError(f"{name} has a fixed number of crossings; coil, several and random take one")
    if strings is not None and name not in ("several", "random"):
        raise SceneError(f"{name} is one string; several and random take a number of strings")
    if name == "coil" and crossings == 0:
        raise SceneError("coil: at least one crossing is needed")
