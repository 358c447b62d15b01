"""Estimate the accuracy of detected corners from how well they lie on one flat board."""

import math

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_refinement import apply_homography

MIN_CORNERS_FOR_SIGMA = 12
"""Minimum number of corners for an estimate. Fewer leave too few residual degrees of freedom."""
MIN_CORNERS_FOR_DISTORTION = 24
"""Minimum number of corners from which lens distortion is fitted too."""
MAX_ITERATIONS = 3
"""Maximum number of fits, each without the outliers of the fit before."""
MAX_RESIDUAL_SIGMAS = 6.0
"""Maximum residual of a corner, in standard deviations. A larger one is another thing: a cable across the corner, or a
reflection."""
MIN_OUTLIER_PX = 0.1
"""Minimum residual of an outlier, pixels. A corner with a small error is still better than no corner."""
SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution divided by the median of its absolute values."""


def find_planar_corners(
    board: Board, ids: NDArray[np.int64], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], float | None]:
    """Find the corners that lie on one flat board, and estimate their noise.

    The corners are compared with a homography, plus cubic polynomials for the lens if there are enough corners. Smooth
    errors, such as those of a bent board, are explained by the fit; the remaining residual is the noise.

    Args:
        board: The board.
        ids: (N,) numbers of the corners.
        pixels: (N, 2) pixels of the corners.

    Returns:
        Mask (N,) of the corners that fit, and the standard deviation of one coordinate of these, pixels. With fewer
        than `MIN_CORNERS_FOR_SIGMA` corners the mask is all true and the standard deviation is None.
    """
    inliers = np.ones(len(ids), dtype=bool)
    sigma = None
    if len(ids) < MIN_CORNERS_FOR_SIGMA:
        return inliers, sigma
    points = board.points[ids, :2] / board.pitch_m
    for _ in range(MAX_ITERATIONS):
        residuals, n_parameters = _fit_residuals(points, pixels, inliers)
        n_inliers = int(inliers.sum())
        # The fit absorbs part of the noise of the corners that it uses.
        remaining = math.sqrt(1.0 - n_parameters / (2 * n_inliers))
        sigma = SIGMA_PER_MAD * float(np.median(np.abs(residuals[inliers]))) / remaining
        near = np.linalg.norm(residuals, axis=1) <= max(MAX_RESIDUAL_SIGMAS * sigma, MIN_OUTLIER_PX)
        if near.sum() < MIN_CORNERS_FOR_SIGMA or (near == inliers).all():
            break
        inliers = near
    return inliers, sigma


def _fit_residuals(
    points: NDArray[np.float64], pixels: NDArray[np.float64], inliers: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], int]:
    """Return the residuals (N, 2) of a fit to the inliers, pixels, and the number of parameters of the fit."""
    import cv2

    H = np.asarray(cv2.findHomography(points[inliers], pixels[inliers], 0)[0], dtype=np.float64)
    residuals = pixels - apply_homography(H, points)
    if inliers.sum() < MIN_CORNERS_FOR_DISTORTION:
        return residuals, 8
    x, y = (2 * (points - points.min(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-9) - 1).T
    powers = [(i, j) for i in range(4) for j in range(4 - i)]
    terms = np.column_stack([x**i * y**j for i, j in powers])
    distortion = np.linalg.lstsq(terms[inliers], residuals[inliers], rcond=None)[0]
    # The polynomials contain nearly all parameters of the homography.
    return residuals - terms @ distortion, 2 * len(powers)
