"""Curves that join two ends with little bending energy, and their crossings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.intersections import planar_cross
from recognition.geometry.polyline import angles_between

N_SAMPLES = 21
"""Number of points on a joining curve."""
MIN_TURN_RAD = 0.01
"""Minimum turn for which the length of the tangents is computed, radians. At zero, the formula divides by zero."""
MAX_TURN_RAD = 4.5
"""Maximum turn for which the length of the tangents is computed, radians."""
MAX_CHORD_TURN_RAD = 2.6
"""Turn above which the tangents grow as if the chord were that of this turn, radians. The chord of an arc that turns
fully is zero."""
MIN_SPEED_M = 1e-9
"""Lower limit of the derivative of a curve by its parameter, metres. It keeps the curvature finite."""
MIN_CROSS_M2 = 1e-18
"""Minimum cross product of two links that are not parallel, square metres."""

Points = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JoiningCurves:
    """Curves of little bending energy between pairs of ends."""

    points: Points
    """(M, N, 3) points of each curve, from end to end, metres, base frame."""
    length: NDArray[np.float64]
    """(M,) length of each curve, metres."""
    energy: NDArray[np.float64]
    """(M,) integral of the squared curvature over the length of each curve, 1/m."""


def joining_curves(
    start: Points, leaving: Points, end: Points, arriving: Points, fullness: float = 1.0
) -> JoiningCurves:
    """Return the curves that leave one end and arrive at the other one with little bending energy.

    The curves are cubic. Their tangents are as long as those of an arc that turns by the sum of both angles with the
    chord, the curve of least energy if the two angles are equal.

    Args:
        start: (M, 3) positions of the first ends, metres.
        leaving: (M, 3) unit directions of the curves at the first ends.
        end: (M, 3) positions of the second ends, metres.
        arriving: (M, 3) unit directions of the curves at the second ends.
        fullness: Length of the tangents, relative to those of the arc. A smaller value gives narrower curves.

    Returns:
        The curves.

    Source:
        Horn, "The curve of least energy" (1983), discusses the exact curve.
    """
    chord = end - start
    turn = angles_between(leaving, chord) + angles_between(arriving, chord)
    turn = np.clip(turn, MIN_TURN_RAD, MAX_TURN_RAD)
    # An arc that turns by phi over the chord c is nearly a cubic with tangents of 2 c tan(phi / 4) / sin(phi / 2).
    chord_turn = np.minimum(turn, MAX_CHORD_TURN_RAD)
    scale = fullness * 2 * np.tan(turn / 4) / np.sin(chord_turn / 2) * np.linalg.norm(chord, axis=1)

    # A cubic Hermite spline and its first two derivatives by the parameter t, each as an array (M, N, 3).
    t = np.linspace(0, 1, N_SAMPLES)[None, :, None]
    start_tangent = (scale[:, None] * leaving)[:, None]
    end_tangent = (scale[:, None] * arriving)[:, None]
    start = start[:, None]
    end = end[:, None]
    chord = chord[:, None]
    points = (
        (2 * t**3 - 3 * t**2 + 1) * start
        + (t**3 - 2 * t**2 + t) * start_tangent
        + (3 * t**2 - 2 * t**3) * end
        + (t**3 - t**2) * end_tangent
    )
    first = (6 * t - 6 * t**2) * chord + (3 * t**2 - 4 * t + 1) * start_tangent + (3 * t**2 - 2 * t) * end_tangent
    second = (6 - 12 * t) * chord + (6 * t - 4) * start_tangent + (6 * t - 2) * end_tangent

    speed = np.maximum(np.linalg.norm(first, axis=2), MIN_SPEED_M)
    curvature = np.linalg.norm(np.cross(first, second), axis=2) / speed**3
    step = 1 / (N_SAMPLES - 1)
    return JoiningCurves(
        points=points,
        length=np.trapezoid(speed, dx=step, axis=1),
        energy=np.trapezoid(curvature**2 * speed, dx=step, axis=1),
    )


def first_crossings(one: Points, other: Points) -> tuple[NDArray[np.bool_], Points, Points]:
    """Return which polylines cross, seen from above, and where.

    Args:
        one: (M, N, 3) points of the first polyline of each pair.
        other: (M, N, 3) points of the second polyline of each pair.

    Returns:
        Mask (M,) of the pairs that cross, and the point (M, 3) of each polyline at the first crossing.
    """
    # Each link of one polyline against each link of the other one: the axes are pair, link, other link, coordinate.
    p = one[:, :-1, None]
    u = np.diff(one, axis=1)[:, :, None]
    q = other[:, None, :-1]
    v = np.diff(other, axis=1)[:, None]
    cross = planar_cross(u, v)
    cross = np.where(np.abs(cross) < MIN_CROSS_M2, np.inf, cross)
    offset = q - p
    s = planar_cross(offset, v) / cross
    t = planar_cross(offset, u) / cross
    is_hit = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1) & np.isfinite(cross)

    n_pairs = len(one)
    n_links = (one.shape[1] - 1) * (other.shape[1] - 1)
    is_hit = is_hit.reshape(n_pairs, n_links)
    pair = np.arange(n_pairs)
    first_hit = is_hit.argmax(axis=1)
    on_one = (p + s[..., None] * u).reshape(n_pairs, n_links, 3)[pair, first_hit]
    on_other = (q + t[..., None] * v).reshape(n_pairs, n_links, 3)[pair, first_hit]
    return np.asarray(is_hit.any(axis=1)), on_one, on_other
