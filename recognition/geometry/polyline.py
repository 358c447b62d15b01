"""Polylines: arc lengths, resampling, unit vectors, and the direction and parabola of an end."""

import numpy as np
from numpy.typing import NDArray

DISTURBED_RADII = 0.55
"""Distance from the end, in radii, within which objects beside the end may displace the points."""
DISTURBED_WEIGHT = 0.25
"""Weight of points within `DISTURBED_RADII` in the fit of the parabola. Other points have the weight 1."""
MIN_BENT_RADII = 3.0
"""Minimum length of a line for the fit of a bend, in radii."""
MIN_BENT_POINTS = 5
"""Minimum number of points of a line for the fit of a bend."""
MIN_STEPS = 2
"""Minimum number of steps of a resampled polyline."""
ROUNDING_STEPS = 1e-9
"""Excess over a whole number of steps that is due to rounding and adds no step."""
MIN_LENGTH = 1e-12
"""Lower limit of the length by which a vector is divided. It keeps zero vectors zero."""


def arc_length(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the arc length (N,) from the first point of the polyline `points` (N, D) to each point."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def points_at(points: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points on a polyline at the given arc lengths.

    Args:
        points: (N, D) points of the polyline, metres.
        s: (M,) arc lengths, metres. An arc length beyond an end gives the end.

    Returns:
        Points (M, D), metres.
    """
    along = arc_length(points)
    return np.column_stack([np.interp(s, along, coordinate) for coordinate in points.T])


def resample(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return equally spaced points on a polyline, from end to end, in at least two steps.

    Args:
        points: (N, D) points of the polyline, metres.
        step: Maximum step, metres.

    Returns:
        Points (M, D), metres.
    """
    return points_at(points, resampled_lengths(points, step))


def resampled_lengths(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return the arc lengths (M,) of the points that `resample` returns, metres."""
    length = float(arc_length(points)[-1])
    n_steps = max(int(np.ceil(length / step - ROUNDING_STEPS)), MIN_STEPS)
    return np.linspace(0.0, length, n_steps + 1)


def close_polyline(points: NDArray[np.float64], closed: bool) -> NDArray[np.float64]:
    """Return `points` (N, D), with the first point appended if the polyline is closed."""
    if not closed:
        return points
    return np.vstack([points, points[:1]])


def unit_vectors(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalise the vectors (..., D). A zero vector stays zero."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), MIN_LENGTH)


def angles_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles (N,) between vectors (N, 3), radians."""
    return np.arccos(np.clip((unit_vectors(a) * unit_vectors(b)).sum(axis=1), -1, 1))


def end_direction(points: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """Return the outward direction of a polyline at its first point.

    Args:
        points: (N, D) points of the polyline, metres.
        length: Distance from the first point over which the direction is measured, metres.

    Returns:
        Unit vector (D,) pointing out of the polyline; zero if all points coincide.
    """
    is_far = np.linalg.norm(points - points[0], axis=1) > length
    inner = np.argmax(is_far) if is_far.any() else -1
    offset = points[0] - points[inner]
    return offset / max(float(np.linalg.norm(offset)), MIN_LENGTH)


def fit_end_parabola(line: NDArray[np.float64], length: float, r: float) -> NDArray[np.float64]:
    """Fit a parabola to the first part of a polyline. Its terms are the position, direction and bend of the end.

    The parabola is `terms[0] + s * terms[1] + s**2 * terms[2]` at the arc length s from the first point.

    Args:
        line: (N, 3) points of the polyline, metres, N >= 2.
        length: Length of the fitted part, metres.
        r: String radius, metres.

    Returns:
        Terms (3, 3). The third term is zero if the part is too short or has too few points for a bend.
    """
    s = arc_length(line)
    n = max(int(np.searchsorted(s, length)) + 1, 2)
    s = s[:n]
    points = line[:n]
    has_points = len(s) >= MIN_BENT_POINTS
    weight = np.where((s < DISTURBED_RADII * r) & has_points, DISTURBED_WEIGHT, 1.0)
    degree = 2 if has_points and s[-1] > MIN_BENT_RADII * r else 1
    powers = np.vander(s, degree + 1, increasing=True)
    # If all points coincide, the parabola stays at this point.
    terms, *_ = np.linalg.lstsq(weight[:, None] * powers, weight[:, None] * points)
    return np.vstack([terms, np.zeros((2 - degree, 3))]).astype(np.float64)
