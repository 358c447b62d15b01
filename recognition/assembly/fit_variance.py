"""Variance of a fitted strand across the string: noise, bending penalty, and bends that no surface shows.

The fit of a tube is a smoothing spline: it minimises the squared residuals of the surface plus a penalty on the second
differences of the line. Its error has three parts:

- the noise of the surface, which the fit averages;
- the bias of the penalty, which pulls a bend inwards where little surface supports it;
- bends that the visible lengths do not show. The curvature of a string is a random process of a certain variance. The
  error is 0 at the ends of an exactly known hidden length of length L, and its variance grows as L^3 in the middle.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from recognition.geometry.polyline import arc_length
from recognition.refinement.refinement import STEP_RADII, FittedStrand
from recognition.refinement.tube_fit import BEND_SIGMA_RADII, SECOND_DIFFERENCE

BEND_LENGTH_RADII = 2.0
"""Length over which the curvature of a string stays the same, in radii.

The density of its bending is this length times its mean squared curvature. The value was chosen on simulated heaps:
with it, 2 sigma covers 95 % of the errors there.
"""
BEND_POINTS = round(BEND_LENGTH_RADII / STEP_RADII)
"""The same length, in points of a strand."""
NEAR_POINTS = 8
"""Number of points on each side of a point from which its mean squared curvature is taken. A string bends more in a
knot than in its tails."""
STRAIGHT_DENSITY = BEND_SIGMA_RADII**2 / STEP_RADII**3
"""Lower limit of the density, 1 / r. It is the density of the bending penalty of the fit."""
UNKNOWN_RADII = 10.0
"""Standard deviation of a hidden point that nothing is known of, in radii."""
MIN_POINT_VARIANCE_M2 = 1e-14
"""Lower limit of twice the squared scatter, square metres. It prevents division by zero on exact surface."""
DIRECTIONS_FACTOR = 1.5
"""Larger eigenvalue plus half the smaller one of a covariance across the string that is equal in all directions, in
variances of one direction."""
WINDOW_POINTS = 128
"""Number of points of a strand that are computed together."""
WINDOW_MARGIN_POINTS = 64
"""Number of further points on each side of them that influence them."""


def fit_variance(strand: FittedStrand, scatter_m: float) -> NDArray[np.float64]:
    """Return the variance across the string of each point of a fitted strand.

    Args:
        strand: Fitted strand with N points.
        scatter_m: Standard deviation of the surface points about the fitted tubes, metres.

    Returns:
        Variances (N,), metres squared. Each is the larger eigenvalue of the covariance plus half the smaller one.

    Source:
        Wahba, "Spline models for observational data" (1990), section 1.4: the smoothing spline is the mean of a
        Gaussian process whose second derivative is white noise.
    """
    n = len(strand.points)
    # Normals point in all directions across the string, so each direction has half of the points.
    point_variance = 2 * scatter_m**2
    if n < 3:
        if strand.bridged.any():
            return np.full(n, (UNKNOWN_RADII * strand.radius_m) ** 2)
        return np.full(n, DIRECTIONS_FACTOR * point_variance)
    step = float(arc_length(strand.points)[-1]) / (n - 1)
    information = np.where(strand.bridged, 0.0, strand.support / max(point_variance, MIN_POINT_VARIANCE_M2))
    information = np.maximum(information, (UNKNOWN_RADII * strand.radius_m) ** -2.0)
    # The second differences of curvature that stays the same over the bend length have this standard deviation.
    bend = np.sqrt(bending_density(strand, step) * step**4 / (BEND_LENGTH_RADII * strand.radius_m))
    variance = np.zeros(n)
    for first in range(0, n, WINDOW_POINTS):
        last = min(first + WINDOW_POINTS, n)
        window_first = first - WINDOW_MARGIN_POINTS
        window_last = last + WINDOW_MARGIN_POINTS
        if not strand.closed:
            window_first = max(window_first, 0)
            window_last = min(window_last, n)
        # The window of a closed strand may go round it.
        window = np.arange(window_first, window_last) % n
        of_window = _window_variance(strand.points[window], information[window], bend[window], strand.radius_m)
        variance[first:last] = of_window[first - window_first : last - window_first]
    return variance


def bending_density(strand: FittedStrand, step: float) -> NDArray[np.float64]:
    """Return the spectral density (N,) of the curvature at each point, in each direction across the string, 1/m.

    The mean squared curvature is that of the visible lengths near the point. The mean over the whole strand is added as
    one sample, and is used alone where no visible length is near.

    Args:
        strand: Fitted strand with N points.
        step: Distance of its points, metres.
    """
    n = len(strand.points)
    # A closed strand goes on before its first point and after its last point.
    pad = NEAR_POINTS + 1 if strand.closed else 0
    around = np.arange(-pad, n + pad) % n
    points = strand.points[around]
    hidden = strand.bridged[around]
    square = np.zeros(len(points))
    square[1:-1] = ((_second_differences(points) / step**2) ** 2).sum(axis=1) / 2
    is_visible = np.zeros(len(points), dtype=bool)
    is_visible[1:-1] = ~(hidden[:-2] | hidden[1:-1] | hidden[2:])
    square[~is_visible] = 0.0
    mean_square = square.sum() / max(is_visible.sum(), 1)
    n_near = 2 * NEAR_POINTS + 1
    # A moving sum stands at the last of its points, which is NEAR_POINTS after the middle one.
    near = slice(NEAR_POINTS + pad, NEAR_POINTS + pad + n)
    sums = _moving_sum(square, n_near)[near]
    counts = _moving_sum(is_visible.astype(np.float64), n_near)[near]
    local = (sums + mean_square) / (counts + 1)
    r = strand.radius_m
    return np.maximum(BEND_LENGTH_RADII * r * local, STRAIGHT_DENSITY / r)


def _window_variance(
    points: NDArray[np.float64], information: NDArray[np.float64], bend: NDArray[np.float64], r: float
) -> NDArray[np.float64]:
    """Return the variances (N,) at the points (N, 3) of a part of a strand.

    Args:
        points: (N, 3) points, metres.
        information: (N,) inverse variance of each point in each direction across, from its own surface, 1 / m^2.
        bend: (N,) standard deviation of the second difference in each direction across, metres.
        r: Radius of the string, metres.
    """
    n = len(points)
    penalty = (BEND_SIGMA_RADII * r) ** -2.0
    bands = np.zeros((3, n))
    bands[2] = information
    inner = np.arange(n - 2)
    for a in range(3):
        for b in range(a + 1):
            bands[2 - (a - b), inner + a] += SECOND_DIFFERENCE[a] * SECOND_DIFFERENCE[b] * penalty
    # Displacements of the fitted points (columns) by a unit force on one of them (rows); the matrix is symmetric.
    X = solveh_banded(bands, np.eye(n))
    by_bend = penalty * _second_differences(X.T).T
    noise = X**2 @ information
    runs = _moving_sum(by_bend * bend[1:-1], BEND_POINTS) / np.sqrt(BEND_POINTS)
    bias = by_bend @ _second_differences(points)
    unseen_bends = (runs**2).sum(axis=1)
    return np.asarray(DIRECTIONS_FACTOR * (noise + unseen_bends) + (bias**2).sum(axis=1), dtype=np.float64)


def _second_differences(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the second differences (N - 2, ...) along the first axis."""
    return np.diff(values, 2, axis=0)


def _moving_sum(values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Return the sums (..., N + count - 1) of all runs of up to `count` neighbours along the last axis."""
    padding = [(0, 0)] * (values.ndim - 1) + [(count, count - 1)]
    sums = np.cumsum(np.pad(values, padding), axis=-1)
    return np.asarray(sums[..., count:] - sums[..., :-count], dtype=np.float64)
