"""Curves that join two ends with little bending energy, and their crossings."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import angles_between

N_SAMPLES = 21
"""Number of points on a joining curve."""

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
    turn = np.clip(angles_between(leaving, chord) + angles_between(arriving, chord), 0.01, 4.5)
    # An arc that turns by phi over the chord c is nearly a cubic with tangents of 2 c tan(phi / 4) / sin(phi / 2).
    scale = fullness * 2 * np.tan(turn / 4) / np.sin(np.minimum(turn, 2.6) / 2) * np.linalg.norm(chord, axis=1)
    t = np.linspace(0, 1, N_SAMPLES)[None, :, None]
    tangents = scale[:, None] * leaving, scale[:, None] * arriving
    points = (
        (2 * t**3 - 3 * t**2 + 1) * start[:, None]
        + (t**3 - 2 * t**2 + t) * tangents[0][:, None]
        + (3 * t**2 - 2 * t**3) * end[:, None]
        + (t**3 - t**2) * tangents[1][:, None]
    )
    first = (6 * t - 6 * t**2) * chord[:, None] + (3 * t**2 - 4 * t + 1) * tangents[0][:, None]
    first += (3 * t**2 - 2 * t) * tangents[1][:, None]
    second = (6 - 12 * t) * chord[:, None] + (6 * t - 4) * tangents[0][:, None] + (6 * t - 2) * tangents[1][:, None]
    speed = np.maximum(np.linalg.norm(first, axis=2), 1e-9)
    curvature = np.linalg.norm(np.cross(first, second), axis=2) / speed**3
    step = 1 / (N_SAMPLES - 1)
    return JoiningCurves(
        points, np.trapezoid(speed, dx=step, axis=1), np.trapezoid(curvature**2 * speed, dx=step, axis=1)
    )


def first_crossings(one: Points, other: Points) -> tuple[NDArray[np.bool_], Points, Points]:
    """Return which polylines cross, seen from above, and where.

    Args:
        one: (M, N, 3) points of the first polyline of each pair.
        other: (M, N, 3) points of the second polyline of each pair.

    Returns:
        Mask (M,) of the pairs that cross, and the point (M, 3) of each polyline at the first crossing.
    """
    p, u = one[:, :-1, None], np.diff(one, axis=1)[:, :, None]
    q, v = other[:, None, :-1], np.diff(other, axis=1)[:, None]
    cross = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    cross = np.where(np.abs(cross) < 1e-18, np.inf, cross)
    offset = q - p
    s = (offset[..., 0] * v[..., 1] - offset[..., 1] * v[..., 0]) / cross
    t = (offset[..., 0] * u[..., 1] - offset[..., 1] * u[..., 0]) / cross
    n_links = (one.shape[1] - 1) * (other.shape[1] - 1)
    meets = ((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1) & np.isfinite(cross)).reshape(len(one), n_links)
    chosen = np.arange(len(one)), meets.argmax(axis=1)
    on_one = (p + s[..., None] * u).reshape(len(one), n_links, 3)[chosen]
    on_other = (q + t[..., None] * v).reshape(len(one), n_links, 3)[chosen]
    return np.asarray(meets.any(axis=1)), on_one, on_other
