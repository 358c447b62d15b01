"""Least squares fit of a nearly level plane, alone or beside another plane."""

import numpy as np
from numpy.typing import NDArray

APART_INLIERS_M = (-0.002, 0.0008)
"""Range of the distances of inliers from a plane beside another one, metres. The upper limit excludes a flat object."""
APART_PASSES = 6
"""Number of passes of the fit of a plane beside another one."""
MIN_INLIERS = 100
"""Minimum number of inliers of a plane."""


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
