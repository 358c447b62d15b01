"""Check the camera matrix, the distortion and the mounting."""

from typing import get_args

import numpy as np
from numpy.typing import NDArray

from calibration.errors import HandEyeInputError
from calibration.observations import Mounting

AXIS_SHARES = (0.2, 0.8)
"""Range of the principal point, as fractions of the image width and height. A principal point outside this range means
that K belongs to another resolution."""
FOCAL_SHARES = (0.1, 20.0)
"""Range of the focal lengths, as fractions of the image width: from a fish-eye lens to a telescope."""
MAX_SKEW = 1e-6
"""Maximum skew, as a fraction of the focal length. It allows for rounding only."""
DISTORTION_SIZES = (0, 4, 5, 8, 12, 14)
"""Numbers of distortion coefficients that are valid in OpenCV; 0 for rectified images."""


def check_camera(K: NDArray[np.float64], distortion: NDArray[np.float64], image_size: tuple[int, int]) -> None:
    """Check that the camera matrix and the distortion are plausible for the image size.

    Args:
        K: (3, 3) pinhole matrix, pixels.
        distortion: Distortion coefficients in OpenCV order; empty for rectified images.
        image_size: Width and height of the images, pixels.

    Raises:
        HandEyeInputError: The camera matrix, the distortion or the image size is wrong. `slug` is "not-finite" or
            "intrinsics".
    """
    width, height = image_size
    K = np.asarray(K, dtype=np.float64)
    distortion = np.asarray(distortion, dtype=np.float64)
    if not (np.isfinite(K).all() and np.isfinite(distortion).all()):
        raise HandEyeInputError(
            "not-finite", "the camera matrix or the distortion holds NaN or infinity: read it from the camera again"
        )
    to_do = "take K of the same stream and resolution as the images"
    problem = None
    if width <= 0 or height <= 0:
        problem = f"the image has {width} x {height} pixels"
    elif K.shape != (3, 3):
        problem = f"K has shape {K.shape} instead of (3, 3)"
    elif K[1, 0] != 0 or not np.array_equal(K[2], (0.0, 0.0, 1.0)):
        problem = "K does not have the form [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
        to_do = "write it row by row, in pixels"
    elif not abs(K[0, 1]) <= MAX_SKEW * abs(K[0, 0]):
        problem = f"K has a skew of {K[0, 1]:.5g}, and only cameras without skew are supported"
        to_do = "calibrate the camera without skew, or take the K that the camera reports"
    elif not (_is_plausible_focal(K[0, 0], width) and _is_plausible_focal(K[1, 1], width)):
        problem = f"the focal lengths {K[0, 0]:.5g} and {K[1, 1]:.5g} pixels do not fit a width of {width} pixels"
    elif not (_is_near_middle(K[0, 2], width) and _is_near_middle(K[1, 2], height)):
        axis = f"({K[0, 2]:.5g}, {K[1, 2]:.5g})"
        problem = f"the optical axis at {axis} is not near the middle of {width} x {height} pixels"
    elif distortion.size not in DISTORTION_SIZES:
        problem = f"the distortion has {distortion.size} coefficients, and OpenCV has 0, 4, 5, 8, 12 or 14"
    if problem is not None:
        raise HandEyeInputError("intrinsics", f"the camera matrix is wrong, {problem}: {to_do}")


def _is_near_middle(position_px: float, size_px: int) -> bool:
    min_share, max_share = AXIS_SHARES
    return min_share * size_px < position_px < max_share * size_px


def _is_plausible_focal(focal_px: float, width_px: int) -> bool:
    min_share, max_share = FOCAL_SHARES
    return min_share * width_px < focal_px < max_share * width_px


def check_mounting(mounting: str) -> None:
    """Check that `mounting` is "eye-in-hand" or "eye-to-hand".

    Raises:
        HandEyeInputError: `mounting` has another value. `slug` is "mounting".
    """
    if mounting not in get_args(Mounting):
        raise HandEyeInputError(
            "mounting", f"the mounting is {mounting!r}: give {' or '.join(map(repr, get_args(Mounting)))}"
        )
