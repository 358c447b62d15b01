"""Random courses of strings on the table with a given number of crossings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.planar_crossings import PlanCrossing, plan_crossings
from cell.simulation.scenes.shapes import STEP_M, polyline_length
from cell.simulation.scenes.strand_clearance import MIN_ANGLE_RAD, SIDE_CLEARANCE, clear
from recognition.geometry.polyline import resample

_STEP_M = 0.003
_CHUNK_STEPS = 70
_EASE_M = 0.009
"""Length over which the curvature changes to a new value."""
_TRIES = 40
_SETBACKS = 2
_ATTEMPTS = 150

Plan = NDArray[np.float64]


@dataclass(frozen=True)
class CourseSettings:
    """Geometry of random courses."""

    radius_m: float
    clearance: float = SIDE_CLEARANCE
    """Smallest distance of strands that do not cross, in radii."""
    bend_radius: float = 4.5
    """Smallest bend radius, in radii."""
    bends_per_m: float = 25.0
    """Number of changes of the curvature per metre."""
    gentleness: float = 1.0
    """Exponent of the curvature. At 1 all curvatures are equally frequent; a larger value makes tight bends rarer."""
    min_angle_rad: float = MIN_ANGLE_RAD
    """Smallest angle of a crossing."""


def wander(
    rng: np.random.Generator, lengths_m: Sequence[float], settings: CourseSettings, crossings: int
) -> list[Plan] | None:
    """Return courses of strings with a total number of crossings, or None if none was found.

    Each string grows by short pieces with random bounded curvature, and turns back where it leaves a circle. A piece
    that would touch another strand, or cross it at a small angle, is drawn again. If no piece fits, the last pieces are
    removed.

    Args:
        rng: Generator of the courses.
        lengths_m: Length of each string.
        settings: Geometry of the courses.
        crossings: Number of crossings of all strings together.
    """
    total_m = sum(lengths_m)
    # random lines of this length cross about total^2 / (pi area) times
    widest_m = max(0.1, 0.16 * np.sqrt(total_m), min(0.065 * total_m, 0.6))
    area_m = min(total_m / (np.pi * np.sqrt(crossings + 0.3)), widest_m)
    for _ in range(_ATTEMPTS):
        grown = _grow(rng, lengths_m, settings, crossings, area_m * rng.uniform(0.8, 1.25))
        if grown is None:
            continue
        plan = [_smooth(curve, length_m) for curve, length_m in zip(grown, lengths_m, strict=True)]
        exact = plan_crossings(plan)
        if len(exact) == crossings and clear(
            plan, exact, settings.radius_m, settings.clearance, min_angle_rad=settings.min_angle_rad
        ):
            corners = np.vstack(plan)
            middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
            return [curve - middle for curve in plan]
    return None


@dataclass(frozen=True)
class _Tip:
    """State of the end of a growing string."""

    count: int
    """Number of points so far."""
    position: NDArray[np.float64]
    heading: float
    curvature: float
    target: float
    """Curvature to which the string is turning."""
    crossings: tuple[PlanCrossing, ...]
    """Crossings of all strands so far."""


@dataclass(frozen=True)
class _Ground:
    """Constraints of a growing string."""

    settings: CourseSettings
    area_m: float
    """Radius of the circle to which the string turns back."""
    crossings: int
    """Requested number of crossings of all strings."""
    share: tuple[float, float]
    """Part of the total length that this string covers, from and to."""

    def suits(self, plan: list[Plan], before: _Tip, progress: float, slack: float) -> tuple[PlanCrossing, ...] | None:
        """Return all crossings, or None if strands are too near or the number of crossings does not fit the progress.

        Args:
            plan: Courses, of which the last is the growing one.
            before: Tip up to which all constraints are known to hold.
            progress: Share of the growing string that exists.
            slack: Allowed deviation from the share of crossings.
        """
        found = before.crossings + plan_crossings(plan, before.count)
        low, high = self.share
        # the chance of a crossing grows with the length that exists, and the ends have no crossings
        expected = self.crossings * min((low + progress * (high - low)) / 0.9, 1.0) ** 1.5
        if len(found) > self.crossings or abs(len(found) - expected) > slack:
            return None
        settings = self.settings
        apart = clear(
            plan, found, settings.radius_m, settings.clearance, progress < 1, settings.min_angle_rad, before.count
        )
        return found if apart else None


def _grow(
    rng: np.random.Generator, lengths_m: Sequence[float], settings: CourseSettings, crossings: int, area_m: float
) -> list[Plan] | None:
    """Return coarse courses in steps of `_STEP_M`, or None if one got stuck."""
    plan: list[Plan] = []
    shares = np.concatenate([[0.0], np.cumsum(lengths_m) / sum(lengths_m)])
    shares[-1] = 1.0
    for k, length_m in enumerate(lengths_m):
        ground = _Ground(settings, area_m, crossings, (shares[k], shares[k + 1]))
        curve = _grow_string(rng, plan, int(np.ceil(length_m / _STEP_M)), ground)
        if curve is None:
            return None
        plan.append(curve)
    return plan


def _grow_string(rng: np.random.Generator, others: list[Plan], steps: int, ground: _Ground) -> Plan | None:
    tip = _start(rng, ground.area_m, plan_crossings(others))
    curve = tip.position[None]
    trail = [tip]
    pieces = steps // _CHUNK_STEPS
    # a short string is restarted, while a long one is shortened
    for _ in range(_SETBACKS + max(pieces * 3 // 2, pieces**2 // 8)):
        if len(curve) == steps + 1:
            return curve
        grown = _piece(rng, others, curve, trail[-1], steps, ground)
        if grown is None:
            del trail[max(len(trail) - int(rng.integers(2, 6)), 1) :]
            curve = curve[: trail[-1].count]
        else:
            curve, tip = grown
            trail.append(tip)
    return None


def _piece(
    rng: np.random.Generator, others: list[Plan], curve: Plan, tip: _Tip, steps: int, ground: _Ground
) -> tuple[Plan, _Tip] | None:
    """Return the string with one more piece and its new tip, or None if no piece fits."""
    for k in range(_TRIES):
        course, heading, curvature, target = _steer(rng, tip, min(_CHUNK_STEPS, steps + 1 - tip.count), ground)
        longer = np.vstack([curve, course])
        progress = (len(longer) - 1) / steps
        exact = progress == 1 and ground.share[1] == 1
        found = ground.suits([*others, longer], tip, progress, 0.5 if exact else 1.0 + 2.0 * k / _TRIES)
        if found is not None:
            return longer, _Tip(len(longer), course[-1], heading, curvature, target, found)
    return None


def _start(rng: np.random.Generator, area_m: float, crossings: tuple[PlanCrossing, ...]) -> _Tip:
    bearing = rng.uniform(0, 2 * np.pi)
    position = area_m * np.sqrt(rng.uniform(0.1, 1.0)) * np.array([np.cos(bearing), np.sin(bearing)])
    return _Tip(1, position, bearing + np.pi + rng.uniform(-1.2, 1.2), 0.0, 0.0, crossings)


def _steer(rng: np.random.Generator, tip: _Tip, steps: int, ground: _Ground) -> tuple[Plan, float, float, float]:
    """Return the next points from a tip, with heading, curvature and target curvature at their end.

    The curvature follows a target that changes every few centimetres.
    """
    settings = ground.settings
    sharpest = 1 / (settings.bend_radius * settings.radius_m)
    x, y = float(tip.position[0]), float(tip.position[1])
    heading, curvature, target = tip.heading, tip.curvature, tip.target
    c, s = float(np.cos(heading)), float(np.sin(heading))
    course = np.empty((steps, 2))
    for k in range(steps):
        if rng.random() < settings.bends_per_m * _STEP_M:
            drawn = float(rng.uniform(-0.9, 0.9))
            target = sharpest * drawn * abs(drawn) ** (settings.gentleness - 1)
        outward = x * c + y * s
        distance = float(np.hypot(x, y))
        wanted = target
        if distance > ground.area_m and outward > -0.5 * distance:
            wanted = 0.9 * sharpest * (1.0 if y * c - x * s < 0 else -1.0)
        curvature += (wanted - curvature) * _STEP_M / _EASE_M
        heading += curvature * _STEP_M
        c, s = float(np.cos(heading)), float(np.sin(heading))
        x, y = x + _STEP_M * c, y + _STEP_M * s
        course[k] = x, y
    return course, heading, curvature, target


def _smooth(curve: Plan, length_m: float) -> Plan:
    """Return a cubic spline through a coarse course, scaled to its length, in even steps of `STEP_M`."""
    from scipy.interpolate import CubicSpline

    t = np.arange(len(curve))
    fine = CubicSpline(t, curve)(np.linspace(0, t[-1], 20 * len(curve)))
    return resample(fine * (length_m / polyline_length(fine)), STEP_M)
