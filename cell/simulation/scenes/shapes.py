"""Named courses of a string on the table, as polylines (N, 2) with a step of at most `STEP_M`."""

import numpy as np
from numpy.typing import NDArray

from cell.simulation.scenes.planar_crossings import is_closed
from recognition.geometry.polyline import arc_length, resample

STEP_M = 0.001
"""Distance of the points of a scene's curves."""

Plan = NDArray[np.float64]


def straight(rng: np.random.Generator, length_m: float) -> Plan:
    """Return a straight line in a random direction."""
    return turned(np.array([[0.0, 0.0], [length_m, 0.0]]), length_m, rng)


def arc(rng: np.random.Generator, length_m: float) -> Plan:
    """Return an arc of 90 to 200 degrees."""
    bend = np.linspace(0.0, np.deg2rad(rng.uniform(90, 200)), 2000)
    return turned(np.column_stack([np.sin(bend), 1 - np.cos(bend)]), length_m, rng)


def loop(rng: np.random.Generator, length_m: float) -> Plan:
    """Return a full turn between two tails that cross once."""
    s = np.linspace(-1.0, 1.0, 2000)
    width = rng.uniform(0.28, 0.36)
    bump = np.exp(-((np.abs(s) / width) ** 3))
    heading = np.cumsum(bump)
    heading *= np.deg2rad(rng.uniform(245, 290)) / heading[-1]
    return turned(np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0), length_m, rng)


def figure_eight(rng: np.random.Generator, length_m: float) -> Plan:
    """Return an 8 with a gap between its ends in the middle of the right lobe, with one crossing.

    It is a lemniscate of Gerono with a random aspect ratio.
    """
    gap = rng.uniform(0.22, 0.4)
    t = np.linspace(gap, 2 * np.pi - gap, 4000)
    return turned(np.column_stack([np.cos(t), rng.uniform(0.9, 1.2) * np.sin(t) * np.cos(t)]), length_m, rng)


def overhand_knot(rng: np.random.Generator, length_m: float) -> Plan:
    """Return a loose overhand knot with three crossings: a trefoil that is cut open in one outer lobe."""
    gap = rng.uniform(0.16, 0.24)
    t = np.linspace(gap, 2 * np.pi - gap, 4000) + np.pi
    trefoil = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)])
    to_end = np.minimum(t - t[0], t[-1] - t)
    outward = 1 + rng.uniform(0.5, 0.7) * np.clip(1 - to_end / 0.9, 0, None) ** 2
    mirrored = np.array([rng.choice([-1.0, 1.0]), 1.0])
    return turned(trefoil * outward[:, None] * mirrored, length_m, rng)


def coil(rng: np.random.Generator, length_m: float, turns: int) -> Plan:
    """Return loops in a row, each of which crosses itself once. The curvature varies once a turn."""
    s = np.linspace(-np.pi, (2 * turns - 1) * np.pi, 1500 * turns)
    heading = s + rng.uniform(0.75, 0.9) * np.sin(s)
    return turned(np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0), length_m, rng)


def ring(rng: np.random.Generator, length_m: float, crossings: int) -> Plan:
    """Return a closed string, a dented circle or with one crossing an 8."""
    t = np.linspace(0.0, 2 * np.pi, 4001)
    if crossings:
        # the ring starts at the far end of a lobe, away from the crossing
        course = np.column_stack([np.cos(t), rng.uniform(0.9, 1.3) * np.sin(t) * np.cos(t)])
    else:
        far = np.ones_like(t)
        for k in (2, 3):
            far += rng.uniform(0.0, 0.5) / k**1.5 * np.cos(k * t + rng.uniform(0, 2 * np.pi))
        course = far[:, None] * np.column_stack([np.cos(t), np.sin(t)])
    course[-1] = course[0]
    return turned(course, length_m, rng)


def spiral(rng: np.random.Generator, length_m: float, pitch_m: float) -> Plan:
    """Return a cable coiled flat on the table, with turns one pitch apart."""
    inner_m = 1.2 * pitch_m
    outer_m = np.sqrt(inner_m**2 + length_m * pitch_m / np.pi)
    # nearly even steps, because the pitch is small compared to the radius
    far = np.sqrt(np.linspace(inner_m**2, 1.01 * outer_m**2, int(length_m / STEP_M) * 4))
    angle = 2 * np.pi * far / pitch_m
    wide = np.column_stack([far * np.cos(angle), rng.choice([-1.0, 1.0]) * far * np.sin(angle)])
    return turned(wide[arc_length(wide) <= length_m * (1 + 1e-3)], length_m, rng)


def bow(rng: np.random.Generator, length_m: float, widest_rad: float) -> Plan:
    """Return an arc of at most this angle in a random direction, with its middle at the origin along x."""
    bend = rng.uniform(-widest_rad, widest_rad) / length_m
    s = np.linspace(-length_m / 2, length_m / 2, int(np.ceil(length_m / STEP_M - 1e-9)) + 1)
    return bent(np.column_stack([s, np.zeros_like(s)]), bend)


def bent(plan: Plan, curvature: float) -> Plan:
    """Return `plan` (N, 2) with the x axis bent to a circle of this curvature, 1/m. Distances along y are kept."""
    x, y = plan[:, 0], plan[:, 1]
    if abs(curvature) < 1e-6:
        return plan
    radius = 1 / curvature
    return np.column_stack([(radius - y) * np.sin(x / radius), radius - (radius - y) * np.cos(x / radius)])


def rotated(plan: Plan, angle_rad: float) -> Plan:
    """Return `plan` rotated counter-clockwise about the origin."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return plan @ np.array([[c, s], [-s, c]])


def turned(plan: Plan, length_m: float, rng: np.random.Generator) -> Plan:
    """Return `plan` scaled to a length, in even steps, rotated at random and centred at the origin."""
    angle = rng.uniform(0, 2 * np.pi)
    plan = rotated(resample(plan * (length_m / polyline_length(plan)), STEP_M), angle)
    return plan - (plan.max(axis=0) + plan.min(axis=0)) / 2


def polyline_length(curve: NDArray[np.float64]) -> float:
    """Return the length of the polyline `curve` (N, d)."""
    return float(arc_length(curve)[-1])


def tightest_bend(plan: Plan) -> float:
    """Return the smallest radius of curvature over 5 points of the polyline `plan` (N, 2) in even steps."""
    if is_closed(plan):
        plan = np.vstack([plan, plan[1:4]])
    step = plan[2:] - plan[:-2]
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    turn = float(np.abs(heading[2:] - heading[:-2]).max(initial=0.0))
    return float(np.linalg.norm(step, axis=1).mean()) / turn if turn > 0 else float("inf")
