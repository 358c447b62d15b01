"""Variance of the hidden lengths of a strand: how far a string may leave the line that bridges them.

A string is a smoothing spline: its curvature is white noise of a certain density, and its visible points are measured
with the variance of the fit. The variance of a hidden length of length L is then 0 at its ends, apart from the errors
of the position and direction of the visible lengths, and grows as L^3 in its middle.
"""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length
from recognition.refinement.refinement import STEP_RADII, FittedStrand
from recognition.refinement.tube_fit import BEND_SIGMA_RADII

BEND_LENGTH_RADII = 2.0
"""Length over which the curvature of a string stays the same, in radii.

The density of its bending is this length times its mean squared curvature. The value was chosen on simulated heaps:
with it, 2 sigma covers 95 % of the errors there.
"""
MARGIN_POINTS = 8
"""Number of visible points on both sides of a hidden length that give its ends their positions and directions."""
STRAIGHT_DENSITY = BEND_SIGMA_RADII**2 / STEP_RADII**3
"""Lower limit of the density, 1 / r. It is the density of the bending penalty of the fit."""
UNKNOWN_RADII = 10.0
"""Standard deviation of a hidden point that nothing is known of, in radii."""


def hidden_variance(strand: FittedStrand, fit_variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the variance across the string at the hidden points of a strand.

    Args:
        strand: Fitted strand with N points, some of which are hidden (`bridged`), and some are not.
        fit_variance: (N,) variance of the fit across the string, metres squared. The values at hidden points have no
            effect.

    Returns:
        Variances (M,) at the M hidden points, metres squared. Like that of the fit, each is the larger eigenvalue of
        the covariance plus half the smaller one.

    Source:
        Wahba, "Spline models for observational data" (1990), section 1.4: the smoothing spline is the mean of a
        Gaussian process whose second derivative is white noise.
    """
    hidden, n = strand.bridged, len(strand.points)
    step = float(arc_length(strand.points)[-1]) / (n - 1)
    bending = 1 / (1.5 * bending_density(strand, step) * step**3)
    unknown = (UNKNOWN_RADII * strand.radius_m) ** -2.0
    information = np.where(hidden, unknown, 1 / np.maximum(fit_variance, 1e-12))
    variance = np.zeros(n)
    for start, stop in _runs(hidden, strand.closed):
        window = np.arange(start - MARGIN_POINTS, stop + MARGIN_POINTS)
        window = window[: start + n - window[0]] % n if strand.closed else window[(window >= 0) & (window < n)]
        second = np.diff(np.eye(len(window)), 2, axis=0)
        covariance = np.linalg.inv(np.diag(information[window]) + bending * second.T @ second)
        is_inside = hidden[window]
        variance[window[is_inside]] = np.diag(covariance)[is_inside]
    return variance[hidden]


def bending_density(strand: FittedStrand, step: float) -> float:
    """Return the spectral density of the curvature of a strand in each direction across it, 1/m.

    The mean squared curvature is that of the visible lengths.

    Args:
        strand: Fitted strand.
        step: Distance of its points, metres.
    """
    points, r = strand.points, strand.radius_m
    least = STRAIGHT_DENSITY / r
    # Over two steps, because the differences of neighbouring points are noisy.
    curvature = (points[4:] - 2 * points[2:-2] + points[:-4]) / (2 * step) ** 2
    visible = np.convolve(strand.bridged, np.ones(5), "valid") == 0 if len(points) >= 5 else np.zeros(0, dtype=bool)
    if not visible.any():
        return least
    mean_square = float((curvature[visible] ** 2).sum(axis=1).mean()) / 2
    return max(BEND_LENGTH_RADII * r * mean_square, least)


def _runs(hidden: NDArray[np.bool_], closed: bool) -> list[tuple[int, int]]:
    """Return the first point of each hidden length and the point after its last one.

    On a closed strand, a hidden length across the first point is one length that begins at a negative index.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]])))
    runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    if closed and len(runs) > 1 and hidden[0] and hidden[-1]:
        (_, stop), *others, (start, _) = runs
        runs = [(start - len(hidden), stop), *others]
    return runs
