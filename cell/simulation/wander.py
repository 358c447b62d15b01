"""Random courses of strings on the table, with a wished number of crossings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.simulation.clearance import clear
from cell.simulation.crossings import plan_crossings
from cell.simulation.shapes import STEP_M, evenly, polyline_length

BEND_RADIUS = 4.5
"""Tightest bend on the table, in string radii."""

_STEP_M = 0.003
_CHUNK_STEPS = 70
_BENDS_PER_M = 25.0
"""How often a string changes its curvature."""
_EASE_M = 0.009
"""Length over which the curvature goes to a new one."""
_TRIES = 40
_SETBACKS = 2
_ATTEMPTS = 150

Plan = NDArray[np.float64]


def wander(
    rng: np.random.Generator, strings: int, length_m: float, radius_m: float, crossings: int, clearance: float
) -> list[Plan] | None:
    """Courses (N, 2) of `strings` strings with so many crossings in all; None if none was found.

    Strands that do not cross stay `clearance` radii apart.

    Each grows by short pieces, steered at random with bounded curvature and turned back where it leaves a
    circle; a piece that would touch another strand, or cross it too flatly, is drawn again, and where none
    goes on, the last pieces are taken back.
    """
    total_m = strings * length_m
    # Random lines of this length cross about total^2 / (pi area) times.
    area_m = min(total_m / (np.pi * np.sqrt(crossings + 0.3)), max(0.1, 0.16 * np.sqrt(total_m)))
    for _ in range(_ATTEMPTS):
        grown = _grow(rng, strings, length_m, radius_m, crossings, clearance, area_m * rng.uniform(0.8, 1.25))
        if grown is None:
            continue
        plan = [_smooth(curve, length_m) for curve in grown]
        exact = plan_crossings(plan)
        if len(exact) == crossings and clear(plan, exact, radius_m, clearance):
            corners = np.vstack(plan)
            middle = (corners.max(axis=0) + corners.min(axis=0)) / 2
            return [curve - middle for curve in plan]
    return None


@dataclass(frozen=True)
class _Tip:
    """Where a growing string has got to."""

    count: int
    """Points so far."""
    position: NDArray[np.float64]
    heading: float
    curvature: float
    target: float
    """The curvature that it is turning to."""


@dataclass(frozen=True)
class _Ground:
    """What a string grows on."""

    radius_m: float
    clearance: float
    area_m: float
    """Radius of the circle that it turns back to."""
    crossings: int
    """Wished in all."""
    share: tuple[float, float]
    """Which part of the strings' whole length this string is."""

    def suits(self, plan: list[Plan], progress: float, slack: float) -> bool:
        """Whether the strings so far keep clear of one another and have about their share of crossings.

        `plan` ends with the growing string, of which this share is laid.
        """
        found = plan_crossings(plan)
        low, high = self.share
        # What can be crossed grows with what lies there; the ends are no place for crossings.
        expected = self.crossings * min((low + progress * (high - low)) / 0.9, 1.0) ** 1.5
        if len(found) > self.crossings or abs(len(found) - expected) > slack:
            return False
        return clear(plan, found, self.radius_m, self.clearance, growing=progress < 1)


def _grow(
    rng: np.random.Generator,
    strings: int,
    length_m: float,
    radius_m: float,
    crossings: int,
    clearance: float,
    area_m: float,
) -> list[Plan] | None:
    """Coarse courses in steps of `_STEP_M`, or None when one got stuck."""
    plan: list[Plan] = []
    for k in range(strings):
        ground = _Ground(radius_m, clearance, area_m, crossings, (k / strings, (k + 1) / strings))
        curve = _grow_string(rng, plan, int(np.ceil(length_m / _STEP_M)), ground)
        if curve is None:
            return None
        plan.append(curve)
    return plan


def _grow_string(rng: np.random.Generator, others: list[Plan], steps: int, ground: _Ground) -> Plan | None:
    tip = _start(rng, ground.area_m)
    curve = tip.position[None]
    trail = [tip]
    for _ in range(_SETBACKS + steps // _CHUNK_STEPS * 3 // 2):
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
    """The string one piece longer and its new tip, or None when no piece suits."""
    for k in range(_TRIES):
        course, new_tip = _steer(rng, tip, min(_CHUNK_STEPS, steps + 1 - tip.count), ground)
        longer = np.vstack([curve, course])
        progress = (len(longer) - 1) / steps
        exact = progress == 1 and ground.share[1] == 1
        if ground.suits([*others, longer], progress, 0.5 if exact else 1.0 + 2.0 * k / _TRIES):
            return longer, new_tip
    return None


def _start(rng: np.random.Generator, area_m: float) -> _Tip:
    bearing = rng.uniform(0, 2 * np.pi)
    position = area_m * np.sqrt(rng.uniform(0.1, 1.0)) * np.array([np.cos(bearing), np.sin(bearing)])
    return _Tip(1, position, bearing + np.pi + rng.uniform(-1.2, 1.2), 0.0, 0.0)


def _steer(rng: np.random.Generator, tip: _Tip, steps: int, ground: _Ground) -> tuple[Plan, _Tip]:
    """So many steps on from `tip`; curvature follows a target that changes every few centimetres."""
    sharpest = 1 / (BEND_RADIUS * ground.radius_m)
    (x, y), heading, curvature, target = tip.position, tip.heading, tip.curvature, tip.target
    course = np.empty((steps, 2))
    for k in range(steps):
        if rng.random() < _BENDS_PER_M * _STEP_M:
            target = sharpest * rng.uniform(-0.9, 0.9)
        outward = x * np.cos(heading) + y * np.sin(heading)
        distance = np.hypot(x, y)
        wanted = target
        if distance > ground.area_m and outward > -0.5 * distance:
            left = y * np.cos(heading) - x * np.sin(heading) < 0
            wanted = 0.9 * sharpest * (1.0 if left else -1.0)
        curvature += (wanted - curvature) * _STEP_M / _EASE_M
        heading += curvature * _STEP_M
        x, y = x + _STEP_M * np.cos(heading), y + _STEP_M * np.sin(heading)
        course[k] = x, y
    return course, _Tip(tip.count + steps, course[-1], heading, curvature, target)


def _smooth(curve: Plan, length_m: float) -> Plan:
    """A cubic spline through the coarse course, scaled to its length, in even steps of `STEP_M`."""
    from scipy.interpolate import CubicSpline

    t = np.arange(len(curve))
    fine = CubicSpline(t, curve)(np.linspace(0, t[-1], 20 * len(curve)))
    return evenly(fine * (length_m / polyline_length(fine)), STEP_M)
