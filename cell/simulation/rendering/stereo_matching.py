"""Disparities of a rectified image pair by semi-global matching, as stereo cameras compute them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_FIXED_POINT = 16
"""OpenCV returns disparities in sixteenths of a pixel."""


@dataclass(frozen=True)
class StereoMatching:
    """Settings of semi-global matching."""

    block_px: int = 5
    """Side of the matching window."""
    smoothness: tuple[int, int] = (8, 32)
    """Penalty of a step of one disparity and of a larger one, per pixel of the window."""
    uniqueness_percent: int = 5
    """Margin by which the best disparity must be better than the second."""
    left_right_px: int = 1
    """Largest difference between the disparities of the left and the right image."""
    contrast_limit: int = 31
    """Limit of the image gradients that are compared."""


def match(
    left: NDArray[np.uint8], right: NDArray[np.uint8], disparities: int, settings: StereoMatching
) -> NDArray[np.float32]:
    """Return the disparity (H, W) of the left image, pixels; negative = not measured.

    Args:
        left: Left image (H, W).
        right: Right image (H, W), on the same rows.
        disparities: Number of whole disparities of the search, a multiple of 16.
        settings: Settings of the matching.
    """
    import cv2

    area = settings.block_px**2
    low, high = settings.smoothness
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=disparities,
        blockSize=settings.block_px,
        P1=low * area,
        P2=high * area,
        disp12MaxDiff=settings.left_right_px,
        preFilterCap=settings.contrast_limit,
        uniquenessRatio=settings.uniqueness_percent,
        mode=cv2.StereoSGBM_MODE_SGBM_3WAY,
    )
    # OpenCV measures nothing in the columns of the first `disparities` pixels, so these are added on the left
    padding = ((0, 0), (disparities, 0))
    steps = matcher.compute(np.pad(left, padding), np.pad(right, padding))[:, disparities:]
    return steps.astype(np.float32) / np.float32(_FIXED_POINT)
