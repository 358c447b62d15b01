"""Polylines: lengths along them, and points at lengths."""

import numpy as np
from numpy.typing import NDArray


def arc_length(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) distances of `points` (N, D) from the first, along the polyline."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def points_at(points: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """(M, D) places on the polyline `points` (N, D) at the arc lengths `s` (M,); its ends beyond them."""
    along = arc_length(points)
    return np.column_stack([np.interp(s, along, coordinate) for coordinate in points.T])


def resample(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """(M, D) places on the polyline `points` (N, D): from end to end in two or more even steps of at most `step`."""
    return points_at(points, resampled_lengths(points, step))


def resampled_lengths(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """(M,) arc lengths at which the places of `resample` lie."""
    length = float(arc_length(points)[-1])
    return np.linspace(0.0, length, max(int(np.ceil(length / step - 1e-9)), 2) + 1)


def close_polyline(points: NDArray[np.float64], closed: bool) -> NDArray[np.float64]:
    """`points` (N, 3), of a closed line with the first once more behind the last."""
    return np.vstack([points, points[:1]]) if closed else points


def end_direction(points: NDArray[np.float64], length: float) -> NDArray[np.float64]:
    """(D,) direction in which the polyline `points` (N, D) ends at its first point, from about `length` within it."""
    away = np.linalg.norm(points - points[0], axis=1) > length
    way = points[0] - points[np.argmax(away) if away.any() else -1]
    return way / max(float(np.linalg.norm(way)), 1e-12)
