"""Named courses of a string on the table, as (N, 2) polylines with points every `STEP_M` or a little less."""

import numpy as np
from numpy.typing import NDArray

from recognition.model import arc_length

STEP_M = 0.001
"""Distance of the points of a scene's curves."""

Plan = NDArray[np.float64]


def straight(rng: np.random.Generator, length_m: float) -> Plan:
    """A straight line in a random direction."""
    return turned(np.array([[0.0, 0.0], [length_m, 0.0]]), length_m, rng)


def arc(rng: np.random.Generator, length_m: float) -> Plan:
    """Part of a circle, 90 to 200 degrees."""
    bend = np.linspace(0.0, np.deg2rad(rng.uniform(90, 200)), 2000)
    return turned(np.column_stack([np.sin(bend), 1 - np.cos(bend)]), length_m, rng)


def loop(rng: np.random.Generator, length_m: float) -> Plan:
    """A full turn between two tails that cross once."""
    s = np.linspace(-1.0, 1.0, 2000)
    width = rng.uniform(0.28, 0.36)
    bump = np.exp(-((np.abs(s) / width) ** 3))
    heading = np.cumsum(bump)
    heading *= np.deg2rad(rng.uniform(245, 290)) / heading[-1]
    return turned(np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0), length_m, rng)


def figure_eight(rng: np.random.Generator, length_m: float) -> Plan:
    """An 8 whose ends meet, apart from a gap, in the middle of the right-hand lobe: one crossing.

    A lemniscate of Gerono, stretched at random.
    """
    gap = rng.uniform(0.22, 0.4)
    t = np.linspace(gap, 2 * np.pi - gap, 4000)
    return turned(np.column_stack([np.cos(t), rng.uniform(0.9, 1.2) * np.sin(t) * np.cos(t)]), length_m, rng)


def overhand_knot(rng: np.random.Generator, length_m: float) -> Plan:
    """A loose overhand knot: a trefoil, cut open in one outer lobe and its ends led outward; three crossings."""
    gap = rng.uniform(0.16, 0.24)
    t = np.linspace(gap, 2 * np.pi - gap, 4000) + np.pi
    trefoil = np.column_stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t)])
    to_end = np.minimum(t - t[0], t[-1] - t)
    outward = 1 + rng.uniform(0.5, 0.7) * np.clip(1 - to_end / 0.9, 0, None) ** 2
    mirrored = np.array([rng.choice([-1.0, 1.0]), 1.0])
    return turned(trefoil * outward[:, None] * mirrored, length_m, rng)


def coil(rng: np.random.Generator, length_m: float, turns: int) -> Plan:
    """Loops laid side by side in a row, each crossing itself once: a curvature that swells once a turn."""
    s = np.linspace(-np.pi, (2 * turns - 1) * np.pi, 1500 * turns)
    heading = s + rng.uniform(0.75, 0.9) * np.sin(s)
    return turned(np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0), length_m, rng)


def turned(plan: Plan, length_m: float, rng: np.random.Generator) -> Plan:
    """`plan` scaled to a length, in even steps, turned at random and centred on the origin."""
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    plan = evenly(plan * (length_m / polyline_length(plan)), STEP_M) @ np.array([[c, s], [-s, c]])
    return plan - (plan.max(axis=0) + plan.min(axis=0)) / 2


def evenly(curve: NDArray[np.float64], step_m: float) -> NDArray[np.float64]:
    """The polyline `curve` (N, d) in even steps of at most `step_m`, both ends kept."""
    s = arc_length(curve)
    even = np.linspace(0.0, s[-1], max(int(np.ceil(s[-1] / step_m - 1e-9)), 2) + 1)
    return np.column_stack([np.interp(even, s, curve[:, k]) for k in range(curve.shape[1])])


def polyline_length(curve: NDArray[np.float64]) -> float:
    """Length of the polyline `curve` (N, d)."""
    return float(arc_length(curve)[-1])


def tightest_bend(plan: Plan) -> float:
    """The least radius of curvature, over 5 points, of the polyline `plan` (N, 2) in even steps."""
    step = plan[2:] - plan[:-2]
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    turn = float(np.abs(heading[2:] - heading[:-2]).max(initial=0.0))
    return float(np.linalg.norm(step, axis=1).mean()) / turn if turn > 0 else float("inf")
