"""Estimate the noise of detected corners from their residuals to one flat board."""

import math

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from calibration.target.corner_refinement import apply_homography

MIN_CORNERS_FOR_SIGMA = 12
"""Minimum number of corners for a noise estimate. Fewer corners leave too few degrees of freedom."""
MIN_CORNERS_FOR_DISTORTION = 24
"""Minimum number of corners for a fit that includes lens distortion."""
HOMOGRAPHY_PARAMETERS = 8
"""Number of parameters of a homography."""
CUBIC_EXPONENTS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (3, 0))
"""Exponents of the image coordinates x and y in a cubic polynomial."""
MAX_ITERATIONS = 3
"""Maximum number of fits. Each fit excludes the outliers of the previous fit."""
MAX_RESIDUAL_SIGMAS = 6.0
"""Maximum residual of an inlier, in standard deviations. Outliers are caused by cables across a corner or by
reflections."""
MIN_OUTLIER_PX = 0.1
"""Minimum residual of an outlier, pixels. A corner with a smaller residual is accurate enough to keep."""
SIGMA_PER_MAD = 1.4826
"""Standard deviation of a normal distribution, divided by its median absolute deviation."""


def find_planar_corners(
    board: Board, ids: NDArray[np.int64], pixels: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], float | None]:
    """Find the corners that lie on one flat board, and estimate their noise.

    The fitted model is a homography. With `MIN_CORNERS_FOR_DISTORTION` or more corners, the model also has cubic
    polynomials for lens distortion. The polynomials also absorb other smooth errors, such as a bent board. The
    remaining residuals are noise.

    Args:
        board: The board.
        ids: (N,) numbers of the corners.
        pixels: (N, 2) pixels of the corners.

    Returns:
        Mask (N,), True for inliers, and the standard deviation of the corner noise per coordinate, pixels. With fewer
        than `MIN_CORNERS_FOR_SIGMA` corners, all corners are inliers and the standard deviation is None.
    """
    inliers = np.ones(len(ids), dtype=bool)
    sigma = None
    if len(ids) < MIN_CORNERS_FOR_SIGMA:
        return inliers, sigma
    points = board.points[ids, :2] / board.pitch_m
    for _ in range(MAX_ITERATIONS):
        residuals, n_parameters = _fit_residuals(points, pixels, inliers)
        n_inliers = int(inliers.sum())
        # The fit absorbs part of the noise, so scale by the degrees of freedom.
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
    """Fit a homography and lens distortion to the inliers.

    Args:
        points: (N, 2) corner positions on the board, in pitches.
        pixels: (N, 2) corner positions in the image, pixels.
        inliers: Mask (N,), True for the corners to fit.

    Returns:
        Residuals (N, 2) of all corners, pixels, and the number of fitted parameters.
    """
    import cv2

    H = np.asarray(cv2.findHomography(points[inliers], pixels[inliers], 0)[0], dtype=np.float64)
    residuals = pixels - apply_homography(H, points)
    if inliers.sum() < MIN_CORNERS_FOR_DISTORTION:
        return residuals, HOMOGRAPHY_PARAMETERS
    x, y = (2 * (points - points.min(axis=0)) / np.maximum(np.ptp(points, axis=0), 1e-9) - 1).T
    terms = np.column_stack([x**i * y**j for i, j in CUBIC_EXPONENTS])
    distortion = np.linalg.lstsq(terms[inliers], residuals[inliers], rcond=None)[0]
    # The homography parameters are not added, because the cubic polynomials span nearly all of them.
    return residuals - terms @ distortion, 2 * len(CUBIC_EXPONENTS)
