"""Strings in space for courses on the table, with a check that they can lie there."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.layout import Draft, SceneRequest, choose_over
from cell.simulation.scenes.low_obstacles import support_heights
from cell.simulation.scenes.planar_crossings import PlanCrossing, is_closed, plan_crossings
from cell.simulation.scenes.rod_relaxation import settle
from cell.simulation.scenes.shapes import STEP_M, tightest_bend
from cell.simulation.scenes.stacking_heights import HeightsError, lay
from cell.simulation.scenes.strand_clearance import MIN_SIDE_CLEARANCE, deepest_overlap, strands_apart
from recognition.geometry.polyline import arc_length, points_at

MIN_BEND = 2.5
"""Smallest bend radius, in radii. A tighter string would buckle."""

HANG_RADII = (11.0, 17.0)
"""Distance from a crossing at which settled strings reach the table, in radii."""
SET_SHARE = (0.75, 0.95)
"""Share of their curvature that settled strings have taken on permanently."""

_TOUCH = 0.02
"""Largest overlap of strands, relative to the sum of their radii. Contacts hold at points 1 mm apart."""


def lay_down(
    rng: np.random.Generator, drawn: Draft, request: SceneRequest, plates: Sequence[Box] = ()
) -> list[NDArray[np.float64]]:
    """Return the centre lines (N, 3) of a draft's strings, with random over and under.

    Args:
        rng: Generator of over and under.
        drawn: Courses and radii of the strings.
        request: Requested properties of the scene.
        plates: Boxes under the strings. The strings lie on them, and on the table beside them.

    Raises:
        HeightsError: The strings cannot lie like that.
    """
    plan, radii_m = drawn.plan, drawn.radii_m
    found = plan_crossings(plan)
    if any(tightest_bend(curve) < MIN_BEND * radius_m for curve, radius_m in zip(plan, radii_m, strict=True)):
        raise HeightsError("bends get too tight")
    if drawn.crossings is not None and len(found) != drawn.crossings:
        raise HeightsError(f"strands cross {len(found)} times instead of {drawn.crossings}")
    if not drawn.touching and not strands_apart(plan, found, MIN_SIDE_CLEARANCE * max(radii_m)):
        raise HeightsError("strands touch side by side")
    over = choose_over(request.name, rng, found)
    raised = _raised(drawn, found, over, request.softness, plates)
    if request.name == "settled":
        raised = _settled(rng, raised, found, request)
    curves = [_cut(curve, length_m, drawn.from_start) for curve, length_m in zip(raised, drawn.lengths_m, strict=True)]
    if deepest_overlap(curves, radii_m) > 1 - request.softness + _TOUCH:
        raise HeightsError("strands intersect")
    return curves


def _raised(
    drawn: Draft, found: tuple[PlanCrossing, ...], over: list[bool], softness: float, plates: Sequence[Box]
) -> list[NDArray[np.float64]]:
    """Return the courses (N, 3) with their heights. Rings are shortened by the length for the heights."""
    support_m = [support_heights(xy, radius_m, plates) for xy, radius_m in zip(drawn.plan, drawn.radii_m, strict=True)]
    heights = lay(drawn.plan, found, over, drawn.radii_m, softness, support_m)
    curves = [np.column_stack([xy, z]) for xy, z in zip(drawn.plan, heights, strict=True)]
    if not any(is_closed(curve) for curve in curves):
        return curves
    shrunk = [
        xy * (length_m / arc_length(curve)[-1])
        for xy, length_m, curve in zip(drawn.plan, drawn.lengths_m, curves, strict=True)
    ]
    heights = lay(shrunk, plan_crossings(shrunk), over, drawn.radii_m, softness)
    return [np.column_stack([xy, z]) for xy, z in zip(shrunk, heights, strict=True)]


def _settled(
    rng: np.random.Generator, raised: list[NDArray[np.float64]], found: tuple[PlanCrossing, ...], request: SceneRequest
) -> list[NDArray[np.float64]]:
    """Return the strings at rest, with a random stiffness and permanent curvature."""
    curves = settle(
        raised, request.radius_m, request.softness, float(rng.uniform(*HANG_RADII)), float(rng.uniform(*SET_SHARE))
    )
    if len(plan_crossings(curves)) != len(found):
        raise HeightsError("strands slid off one another")
    return curves


def _cut(curve: NDArray[np.float64], length_m: float, from_start: bool) -> NDArray[np.float64]:
    """Return `curve` (N, 3) in even steps, cut to a length at both ends or at the last one.

    A ring is not cut.
    """
    s = arc_length(curve)
    spare = 0.0 if is_closed(curve) else (s[-1] - length_m) / 2
    first = 0.0 if from_start else spare
    last = s[-1] - (2 * spare if from_start else spare)
    return points_at(curve, np.linspace(first, last, int(np.ceil(length_m / STEP_M - 1e-9)) + 1))
