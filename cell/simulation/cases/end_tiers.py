"""Tiers of strings that end at, under or beside another strand, and of strings that are joined at one end."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.contacts import SNUG
from cell.simulation.scenes.layout import SceneError
from cell.simulation.scenes.planar_crossings import plan_crossings
from cell.simulation.scenes.scenes import StringScene
from cell.simulation.scenes.shapes import STEP_M, Plan, bow, rotated, tightest_bend
from cell.simulation.scenes.stacking_heights import HeightsError, lay
from recognition.geometry.polyline import arc_length, points_at, resample

END_KINDS = ("in-line", "beyond-over", "beyond-under", "below", "beside", "own-side")
"""Kinds of scenes of the tier `ends`, which takes them in turn."""
RADII_M = (0.003, 0.0042, 0.005)
"""Radii of the strings of the tier `ends`."""
BRANCH_RADIUS_M = (0.003, 0.005)
"""Smallest and largest radius of the strings of the tier `branches`."""
JOINT_CLEARANCE = 3.0
"""Smallest distance of a branch from all strands beyond its joint, in radii."""
JOINT_REACH = 6.0
"""Length of the branch that may be nearer to the trunk, in radii."""
JOINT_GAP_M = 1e-5
"""Distance of the end of a branch from the centre line of its trunk. It keeps crossings out of the truth."""


def draw_ends(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a case of the tier `ends`: one or two strings, with an end near another end or another strand.

    Raises:
        SceneError: The scene cannot be laid.
    """
    radius_m = float(rng.choice(RADII_M))
    kind = END_KINDS[seed % len(END_KINDS)]
    return _case(tier, seed, kind, _DRAWS[kind](rng, radius_m), radius_m)


def draw_branches(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a case of the tier `branches`: a trunk, and one or two branches that end in its centre line.

    Raises:
        SceneError: The branches come too near to another strand.
    """
    radius_m = float(rng.uniform(*BRANCH_RADIUS_M))
    trunk = bow(rng, 0.4, np.deg2rad(80))
    places = rng.uniform(0.3, 0.45), rng.uniform(0.55, 0.7)
    plan = [trunk]
    for place in places[: int(rng.integers(1, 3))]:
        angle = np.deg2rad(rng.uniform(40, 90))
        plan.append(_leaving(rng, trunk, place, angle, float(rng.uniform(0.12, 0.2)), JOINT_GAP_M))
    plan = _centred(rng, plan)
    _check_apart(plan, radius_m)
    return _case(tier, seed, "branches", _on_table(plan, radius_m), radius_m)


def _case(tier: str, seed: int, name: str, curves: Sequence[NDArray[np.float64]], radius_m: float) -> Case:
    scene = StringScene(f"{name}-{seed}", radius_m, tuple(curves))
    return Case(tier, seed, scene, camera_model("ideal"), PoseErrors())


def _in_line(rng: np.random.Generator, radius_m: float) -> list[NDArray[np.float64]]:
    """Return two strings that lie end to end with a gap of 1 to 4 radii."""
    whole = bow(rng, 0.4, np.deg2rad(120))
    middle_m, half_gap_m = float(rng.uniform(0.14, 0.26)), float(rng.uniform(1, 4)) * radius_m / 2
    s = arc_length(whole)
    parts = (
        np.linspace(0, middle_m - half_gap_m, int(middle_m / STEP_M)),
        np.linspace(middle_m + half_gap_m, s[-1], int((s[-1] - middle_m) / STEP_M)),
    )
    return _on_table(_centred(rng, [points_at(whole, part) for part in parts]), radius_m)


def _beyond_over(rng: np.random.Generator, radius_m: float) -> list[NDArray[np.float64]]:
    """Return a string that ends 1 to 3 radii beyond a strand that it lies on."""
    return _crossed(rng, radius_m, is_over=True)


def _beyond_under(rng: np.random.Generator, radius_m: float) -> list[NDArray[np.float64]]:
    """Return a string that ends 1 to 3 radii beyond a strand that lies on it."""
    return _crossed(rng, radius_m, is_over=False)


def _crossed(rng: np.random.Generator, radius_m: float, is_over: bool) -> list[NDArray[np.float64]]:
    """Return a strand, and a string that ends 1 to 3 radii beyond it."""
    trunk, angle = bow(rng, 0.4, np.deg2rad(80)), np.deg2rad(rng.uniform(55, 90))
    place, beyond_m = rng.uniform(0.35, 0.65), float(rng.uniform(1, 3)) * radius_m
    plan = _centred(rng, [trunk, _leaving(rng, trunk, place, angle, 0.25, -beyond_m)])
    return _raised(plan, radius_m, second_is_over=is_over)


def _below(rng: np.random.Generator, radius_m: float) -> list[NDArray[np.float64]]:
    """Return a strand, and a string that ends below it, before the centre line of the strand."""
    trunk, angle = bow(rng, 0.4, np.deg2rad(80)), np.deg2rad(rng.uniform(55, 90))
    place = rng.uniform(0.35, 0.65)
    # The heights are those of a string that passes below the strand. The part beyond the end is cut off.
    plan = _centred(rng, [trunk, _leaving(rng, trunk, place, angle, 0.25, -2 * radius_m)])
    upper, lower = _raised(plan, radius_m, second_is_over=False)
    short_m = 2 * radius_m + float(rng.uniform(0.2, 1)) * radius_m
    s = arc_length(lower)
    return [upper, points_at(lower, np.linspace(short_m, s[-1], int((s[-1] - short_m) / STEP_M)))]


def _beside(rng: np.random.Generator, radius_m: float) -> list[NDArray[np.float64]]:
    """Return a strand, and a string whose end face lies up to 2 radii beside it."""
    trunk, angle = bow(rng, 0.4, np.deg2rad(80)), np.deg2rad(rng.uniform(55, 90))
    place, gap_m = rng.uniform(0.35, 0.65), float(rng.uniform(0, 2)) * radius_m
    short_m = _butting_m(radius_m, angle) + gap_m
    plan = _centred(rng, [trunk, _leaving(rng, trunk, place, angle, 0.25, short_m)])
    _check_apart(plan, radius_m)
    return _on_table(plan, radius_m)


def _own_side(rng: np.random.Generator, radius_m: float) -> list[NDArray[np.float64]]:
    """Return a string whose end face lies against its own side, or up to 2 radii beside it."""
    loop_m, angle = float(rng.uniform(0.035, 0.05)), np.deg2rad(rng.uniform(60, 90))
    turn = np.linspace(0, np.deg2rad(rng.uniform(215, 235)), 400)
    loop = loop_m * np.column_stack([np.sin(turn), 1 - np.cos(turn)])
    tail = np.column_stack([-np.linspace(0.2, STEP_M, 200), np.zeros(200)])
    heading = np.array([np.cos(turn[-1]), np.sin(turn[-1])])
    # The straight end leads from the loop back to the tail.
    short_m = _butting_m(radius_m, angle) + float(rng.uniform(0, 2)) * radius_m
    to_tail_m = loop[-1, 1] / -heading[1] - short_m / np.sin(angle) if heading[1] < 0 else 0.0
    if to_tail_m < 4 * radius_m:
        raise SceneError("the end does not reach the side of the string")
    straight = loop[-1] + np.linspace(STEP_M, to_tail_m, max(int(to_tail_m / STEP_M), 2))[:, None] * heading
    course = resample(np.vstack([tail, loop, straight]), STEP_M)
    if tightest_bend(course) < 4 * radius_m or plan_crossings([course]):
        raise SceneError("the loop is too tight, or it crosses the string")
    return _on_table(_centred(rng, [course * (1.0, rng.choice([-1.0, 1.0]))]), radius_m)


_DRAWS: dict[str, Callable[[np.random.Generator, float], list[NDArray[np.float64]]]] = {
    "in-line": _in_line,
    "beyond-over": _beyond_over,
    "beyond-under": _beyond_under,
    "below": _below,
    "beside": _beside,
    "own-side": _own_side,
}


def _butting_m(radius_m: float, angle: float) -> float:
    """Return the distance from the end to the centre line of a strand that the edge of the end face touches."""
    return radius_m * (SNUG + abs(np.cos(angle))) / np.sin(angle)


def _leaving(
    rng: np.random.Generator, trunk: Plan, place: float, angle: float, length_m: float, start_m: float
) -> Plan:
    """Return a course that leaves a trunk to a random side, at an angle to the direction of the trunk.

    Args:
        rng: Generator of the course.
        trunk: Course (N, 2) of the trunk.
        place: Position on the trunk, as a share of its length.
        angle: Angle between the two courses, radians.
        length_m: Length of the course.
        start_m: Distance of the first point from the trunk. If negative, the course begins beyond the trunk.
    """
    course = bow(rng, length_m, np.deg2rad(50))
    first = course[1] - course[0]
    course = rotated(course - course[0], -float(np.arctan2(first[1], first[0]))) + (start_m, 0.0)
    k = int(len(trunk) * place)
    tangent = trunk[k + 1] - trunk[k - 1]
    direction = float(np.arctan2(tangent[1], tangent[0])) + float(rng.choice([-1.0, 1.0])) * angle
    return rotated(course, direction) + trunk[k]


def _centred(rng: np.random.Generator, plan: Sequence[Plan]) -> list[Plan]:
    """Rotate the courses together at random and centre them, in even steps."""
    angle = rng.uniform(0, 2 * np.pi)
    plan = [resample(rotated(curve, angle), STEP_M) for curve in plan]
    points = np.vstack(plan)
    return [curve - (points.max(axis=0) + points.min(axis=0)) / 2 for curve in plan]


def _check_apart(plan: Sequence[Plan], radius_m: float) -> None:
    """Raise SceneError if the later courses come near another one anywhere but at their first points."""
    for k, branch in enumerate(plan[1:], start=1):
        beyond = branch[arc_length(branch) > JOINT_REACH * radius_m]
        others = np.vstack([curve for n, curve in enumerate(plan) if n != k])
        if np.linalg.norm(beyond[:, None] - others[None], axis=2).min() < JOINT_CLEARANCE * radius_m:
            raise SceneError("two strands come too near to each other")
    if plan_crossings(plan):
        raise SceneError("two strands cross")


def _on_table(plan: Sequence[Plan], radius_m: float) -> list[NDArray[np.float64]]:
    """Return the courses (N, 3) at the height of strings on the table."""
    return [np.column_stack([curve, np.full(len(curve), radius_m)]) for curve in plan]


def _raised(plan: Sequence[Plan], radius_m: float, second_is_over: bool) -> list[NDArray[np.float64]]:
    """Return two courses (N, 3) that cross once, with the heights of strings that lie on each other."""
    found = plan_crossings(plan)
    if len(found) != 1:
        raise SceneError(f"the strings cross {len(found)} times instead of once")
    try:
        heights = lay(plan, found, [not second_is_over], [radius_m] * len(plan), 1.0)
    except HeightsError as error:
        raise SceneError(str(error)) from error
    return [np.column_stack([xy, z]) for xy, z in zip(plan, heights, strict=True)]
