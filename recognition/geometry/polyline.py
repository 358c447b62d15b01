"""Polylines: arc lengths, resampling, unit vectors, and the direction and the parabola of an end."""

import numpy as np
from numpy.typing import NDArray

DISTURBED_RADII = 0.55
"""Points within this distance of the end, in radii, are displaced by objects beside the end."""
DISTURBED_WEIGHT = 0.25
"""Weight of the displaced points in the fit of the parabola; the other points have weight 1."""
MIN_BENT_RADII = 3.0
"""Minimum length of a line that shows a bend, in radii."""


def arc_length(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the arc length (N,) of each point of the polyline `points` (N, D), from the first point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def points_at(points: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points on a polyline at the given arc lengths.

    Args:
        points: (N, D) points of the polyline, metres.
        s: (M,) arc lengths, metres. Arc lengths beyond the ends give the ends.

    Returns:
        (M, D) points, metres.
    """
    along = arc_length(points)
    return np.column_stack([np.interp(s, along, coordinate) for coordinate in points.T])


def resample(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return points on a polyline from end to end, in two or more equal steps.

    Args:
        points: (N, D) points of the polyline, metres.
        step: Largest step, metres.

    Returns:
        (M, D) points, metres.
    """
    return points_at(points, resampled_lengths(points, step))


def resampled_lengths(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return the arc lengths (M,) of the points that `resample` returns for the same arguments, metres."""
    length = float(arc_length(points)[-1])
    return np.linspace(0.0, length, max(int(np.ceil(length / step - 1e-9)), 2) + 1)


def close_polyline(points: NDArray[np.float64], closed: bool) -> NDArray[np.float64]:
    """Return `points` (N, D), with the first point appended if the polyline is closed."""
    return np.vstack([points, points[:1]]) if closed else points


def unit_vectors(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vectors (..., D) divided by their lengths. A zero vector stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def end_direction(points: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """Return the direction in which a polyline ends at its first point.

    Args:
        points: (N, D) points of the polyline, metres.
        length: Distance from the first point over which the direction is measured, metres.

    Returns:
        (D,) unit vector pointing out of the polyline; zero if all points coincide.
    """
    is_far = np.linalg.norm(points - points[0], axis=1) > length
    offset = points[0] - points[np.argmax(is_far) if is_far.any() else -1]
    return offset / max(float(np.linalg.norm(offset)), 1e-12)


def fit_end_parabola(line: NDArray[np.float64], length: float, r: float) -> NDArray[np.float64]:
    """Return the parabola that fits the first part of a polyline: position, direction and bend of its end.

    A point at arc length s from the first point is near `terms[0] + s * terms[1] + s**2 * terms[2]`.

    Args:
        line: (N, 3) points of the polyline, metres, with N at least 2.
        length: Length of the part to fit, metres.
        r: String radius, metres.

    Returns:
        (3, 3) terms of the parabola. The third term is zero if the part is too short for a bend or has too few points.
    """
    s = arc_length(line)
    n = max(int(np.searchsorted(s, length)) + 1, 2)
    s, points = s[:n], line[:n]
    weight = np.where((s < DISTURBED_RADII * r) & (len(s) > 4), DISTURBED_WEIGHT, 1.0)
    degree = 2 if len(s) > 4 and s[-1] > MIN_BENT_RADII * r else 1
    # If all points coincide, least squares returns the parabola that stays at this point.
    terms, *_ = np.linalg.lstsq(weight[:, None] * np.vander(s, degree + 1, increasing=True), weight[:, None] * points)
    return np.vstack([terms, np.zeros((2 - degree, 3))]).astype(np.float64)
