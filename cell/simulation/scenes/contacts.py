"""Strands that touch each other without crossing, and three strands that cross at one point."""

import numpy as np

from cell.simulation.scenes.shapes import STEP_M, Plan, bent, bow, polyline_length, rotated
from recognition.geometry.polyline import resample

SNUG = 1.002
"""Distance of strands in contact, relative to the sum of their radii. No strand penetrates another."""
CONTACT_M = (0.030, 0.080)
"""Length over which strands are side by side."""


def pair(rng: np.random.Generator, length_m: float, radius_m: float) -> list[Plan]:
    """Return two strands that approach, touch side by side, and separate again without crossing."""
    contact_m = rng.uniform(*CONTACT_M)
    bend = rng.uniform(-1.0, 1.0) / 0.15
    plan = []
    for side in (1.0, -1.0):
        x = np.linspace(-0.75 * length_m, 0.75 * length_m, int(1.5 * length_m / STEP_M) * 4)
        left = _leave(-x - contact_m / 2, rng, radius_m)
        right = _leave(x - contact_m / 2, rng, radius_m)
        y = SNUG * radius_m + left + right
        # the strands are not mirror images, so that neither contact is in the middle of a string
        plan.append(_middle(bent(np.column_stack([x, side * y]), bend / 2), length_m))
    return _placed(plan, rng)


def hairpin(rng: np.random.Generator, length_m: float, radius_m: float) -> list[Plan]:
    """Return one string folded back: a narrow bend, two legs in contact, then apart."""
    contact_m = rng.uniform(*CONTACT_M)
    bulb_m, waist_m, leg_m = rng.uniform(3.5, 5.5) * radius_m, rng.uniform(8, 12) * radius_m, SNUG * radius_m
    # the legs approach the axis at the angle at which the counter-bend ends beside it
    closing = np.arccos((leg_m + waist_m) / (bulb_m + waist_m))
    turn = np.linspace(0.0, np.pi / 2 + closing, 400)
    bulb = bulb_m * np.column_stack([1 - np.cos(turn), np.sin(turn)])
    back = np.linspace(closing, 0.0, 400)
    centre = bulb[-1] + waist_m * np.array([np.sin(closing), np.cos(closing)])
    waist = centre - waist_m * np.column_stack([np.sin(back), np.cos(back)])
    legs = []
    for _ in range(2):
        x = np.arange(0.0, length_m, STEP_M / 4)
        leg = np.column_stack([waist[-1, 0] + x, leg_m + _leave(x - contact_m, rng, radius_m)])
        half = np.vstack([bulb, waist[1:], leg[1:]])
        long_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(half, axis=0), axis=1))])
        legs.append(half[long_m <= length_m / 2 * 1.05])
    whole = np.vstack([legs[0][::-1], legs[1][1:] * (1.0, -1.0)])
    course = bent(whole - (waist[-1, 0], 0.0), rng.uniform(-1.0, 1.0) / 0.3)
    return _placed([_middle(course, length_m)], rng)


def end_on_strand(rng: np.random.Generator, length_m: float, radius_m: float, on_top: bool) -> list[Plan]:
    """Return a strand, and one whose end lies on top of it beyond its middle, or butts against its side."""
    under = bow(rng, length_m, np.deg2rad(80))
    place = int(len(under) * rng.uniform(0.35, 0.65))
    angle = np.deg2rad(rng.uniform(55, 125))
    # a square end meets the side of a strand with its centre if perpendicular, and with its edge if oblique
    short_m = radius_m * (SNUG + abs(np.cos(angle))) / np.sin(angle)
    beyond_m = rng.uniform(0.3, 2.0) * radius_m if on_top else -short_m
    coming = bow(rng, length_m, np.deg2rad(60))
    coming = coming - coming[0]
    first = coming[1] - coming[0]
    coming = rotated(coming, -float(np.arctan2(first[1], first[0]))) - (beyond_m, 0.0)
    tangent = under[place + 1] - under[place - 1]
    side = rng.choice([-1.0, 1.0])
    coming = rotated(coming, float(np.arctan2(tangent[1], tangent[0])) + side * angle) + under[place]
    return _placed([under, coming], rng)


def stack(rng: np.random.Generator, length_m: float, radius_m: float) -> list[Plan]:
    """Return three strands that cross within a radius of one point, at about 60 degrees."""
    plan = []
    for k in range(3):
        off_m = np.array([length_m * rng.uniform(-0.12, 0.12), radius_m * rng.uniform(-0.5, 0.5)])
        angle = k * np.pi / 3 + np.deg2rad(rng.uniform(-10, 10))
        plan.append(rotated(bow(rng, length_m, np.deg2rad(50)) + off_m, angle))
    return _placed(plan, rng)


def _leave(beyond_m: np.ndarray, rng: np.random.Generator, radius_m: float) -> np.ndarray:
    """Return the lateral distance of a strand after the end of a contact: a bend of 8 to 14 radii, then straight."""
    slope = np.tan(np.deg2rad(rng.uniform(15, 50)))
    soft_m = slope * rng.uniform(8, 14) * radius_m
    beyond_m = np.maximum(beyond_m, 0.0)
    return slope * (np.sqrt(beyond_m**2 + soft_m**2) - soft_m)


def _middle(plan: Plan, length_m: float) -> Plan:
    """Return the middle part of `plan` with a given length."""
    fine = resample(plan, STEP_M / 8)
    spare = (polyline_length(fine) - length_m) / 2 / (STEP_M / 8)
    return resample(fine[max(round(spare), 0) : len(fine) - max(round(spare), 0)], STEP_M)


def _placed(plan: list[Plan], rng: np.random.Generator) -> list[Plan]:
    """Rotate the strands together at random and centre them at the origin, in even steps."""
    angle = rng.uniform(0, 2 * np.pi)
    plan = [resample(rotated(curve, angle), STEP_M) for curve in plan]
    points = np.vstack(plan)
    return [curve - (points.max(axis=0) + points.min(axis=0)) / 2 for curve in plan]
