"""Least squares fit of a nearly level plane, alone or beside another plane."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

APART_INLIERS_M = (-0.002, 0.0008)
"""Range of the distances of inliers from a plane beside another one, metres. The upper limit excludes a flat object."""
APART_PASSES = 6
"""Number of passes of the fit of a plane beside another one."""
MIN_INLIERS = 100
"""Minimum number of inliers of a plane."""
SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution, relative to its median absolute deviation."""
MODE_SHARE = 0.3
"""Share of the values in the interval from which the standard deviation is taken."""
MODE_WIDTH_SIGMAS = 0.7706
"""Length of the shortest interval with `MODE_SHARE` of a normal distribution, in standard deviations."""
CLIP_SIGMAS = 2.5
"""Distance from the mode up to which values count as its own, in standard deviations."""
CLIPPED_SHARE = 0.9546
"""Standard deviation of the part of a normal distribution within `CLIP_SIGMAS`, in standard deviations of the whole."""
CLIP_PASSES = 4
"""Number of passes of clipping. The first interval is up to a fifth too short."""
PEAK_RANGE_M = (-0.004, 0.02)
"""Range of the heights above the lower of two planes in which a second peak is searched, metres."""
PEAK_BIN_M = 0.0001
"""Width of the bins of the density of heights, metres."""
PEAK_BLUR_M = 0.0003
"""Standard deviation of the blur of the density, metres."""
MIN_PEAK_M = 0.0009
"""Minimum height of the second peak, metres."""
MAX_VALLEY_SHARE = 0.8
"""Maximum density between two peaks, as a share of the lower one."""
APART_SIGMAS = 2.0
"""Minimum distance of points of another plane, in standard deviations of the points of this plane. Noise has 2 % of its
points so far on one side, much less than a plane."""


def fit_plane(A: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the plane (slope along x, slope along y, height) with the least squares of `A @ plane - z`.

    Args:
        A: (N, 3) rows (x, y, 1) of the points.
        z: (N,) heights of the points, metres.
    """
    return np.asarray(np.linalg.lstsq(A.T @ A, A.T @ z, rcond=None)[0], dtype=np.float64)


def fit_apart(
    A: NDArray[np.float64], z: NDArray[np.float64], plane: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return a plane (3,) and its inliers (N,), fitted from a first guess beside points of another plane.

    Args:
        A: (N, 3) rows (x, y, 1) of all points.
        z: (N,) heights of all points, metres.
        plane: (3,) first guess.
    """
    low, high = APART_INLIERS_M
    is_inlier = np.zeros(len(z), dtype=bool)
    for _ in range(APART_PASSES):
        residual = z - A @ plane
        is_inlier = (residual > low) & (residual < high)
        if is_inlier.sum() < MIN_INLIERS:
            break
        plane = fit_plane(A[is_inlier], z[is_inlier])
    return plane, is_inlier


def median_sigma(residuals: NDArray[np.float64]) -> float:
    """Return the standard deviation of normal residuals (N,) with mean zero, from the median of their magnitudes."""
    return SIGMA_PER_MAD * float(np.median(np.abs(residuals)))


def mode_sigma(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of normal values (N,) from the shortest interval with `MODE_SHARE` of them.

    Values of flat objects beside the table are other modes and do not count, while one surface has more than that
    share.
    """
    low, high = _mode_interval(values)
    return (high - low) / MODE_WIDTH_SIGMAS


def clipped_sigma(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of normal values (N,) from those within `CLIP_SIGMAS` of their mode.

    It has no bias for a few hundred values, of which `mode_sigma` returns too little: the shortest interval is short by
    chance. Other modes must be `CLIP_SIGMAS` away.
    """
    low, high = _mode_interval(values)
    middle = (low + high) / 2
    sigma = (high - low) / MODE_WIDTH_SIGMAS
    for _ in range(CLIP_PASSES):
        near = values[np.abs(values - middle) <= CLIP_SIGMAS * sigma]
        if not len(near):
            break
        middle = float(near.mean())
        sigma = float(near.std()) / CLIPPED_SHARE
    return sigma


def _mode_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the shortest interval (low, high) with `MODE_SHARE` of the values (N,)."""
    ordered = np.sort(values)
    n = max(int(MODE_SHARE * len(ordered)), 1)
    first = int(np.argmin(ordered[n:] - ordered[:-n]))
    return float(ordered[first]), float(ordered[first + n])


def is_other_peak(heights: NDArray[np.float64]) -> bool:
    """Return whether heights (N,) above a plane have a second peak, as of a flat object, above a valley.

    The noise of a stereo camera is uneven: 15 % of the points of one plane may be far on one side of it. But they have
    no peak of their own.
    """
    counts, edges = np.histogram(heights, np.arange(*PEAK_RANGE_M, PEAK_BIN_M))
    density = gaussian_filter1d(counts.astype(np.float64), PEAK_BLUR_M / PEAK_BIN_M, mode="constant")
    plane = int(np.searchsorted(edges, 0.0))
    apart = int(np.searchsorted(edges, MIN_PEAK_M))
    upper = apart + int(density[apart:].argmax())
    lower_peak = float(density[: plane + (apart - plane) // 2 + 1].max())
    valley = float(density[plane : upper + 1].min())
    return valley < MAX_VALLEY_SHARE * min(lower_peak, float(density[upper]))


def is_apart(residual: NDArray[np.float64], min_distance_m: float, min_points: float) -> NDArray[np.bool_]:
    """Return the mask (N,) of the points that may belong to another plane; none, if they are too few or noise.

    Args:
        residual: (N,) signed distances from a plane, metres; positive on the side of the other plane. Neighbours in
            the image follow one another.
        min_distance_m: Minimum distance of such points, metres. It is larger if the points scatter more.
        min_points: Minimum number of such points.
    """
    result = residual > min_distance_m
    if result.sum() >= min_points:
        # A plane between two real ones is tilted, so that the distances scatter more than the noise.
        sigma_of_neighbours = median_sigma(np.diff(residual)) / np.sqrt(2)
        sigma = min(mode_sigma(residual), sigma_of_neighbours)
        result = residual > max(min_distance_m, APART_SIGMAS * sigma)
    if result.sum() < min_points:
        return np.zeros(len(residual), dtype=bool)
    return result
