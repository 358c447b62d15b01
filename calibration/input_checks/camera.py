"""A camera as told that cannot be, or that the solver has no room for: its matrix, its distortion, its mounting."""

from typing import get_args

import numpy as np
from numpy.typing import NDArray

from calibration.errors import HandEyeInputError
from calibration.observations import Mounting

AXIS_SHARES = (0.2, 0.8)
"""Of the image's width and height: where the optical axis may be. Farther out, K is of another resolution."""
FOCAL_SHARES = (0.1, 20.0)
"""Focal length as a share of the image's width: from a fish-eye lens to a telescope."""
LARGEST_SKEW = 1e-6
"""As a share of the focal length: rounding. No camera in use has pixels that are not upright."""


def check_camera(K: NDArray[np.float64], distortion: NDArray[np.float64], image_size: tuple[int, int]) -> None:
    """Refuses what cannot be of pictures of this size.

    Raises:
        HandEyeInputError: "not-finite" or "intrinsics".
    """
    width, height = image_size
    K, distortion = (np.asarray(values, dtype=np.float64) for values in (K, distortion))
    if not (np.isfinite(K).all() and np.isfinite(distortion).all()):
        raise HandEyeInputError(
            "not-finite", "the camera's matrix or distortion holds NaN or infinity: read it from the camera anew"
        )
    to_do = "take K of the same stream and resolution as the pictures"
    wrong = None
    if width <= 0 or height <= 0:
        wrong = f"the image has {width} x {height} pixels"
    elif K.shape != (3, 3):
        wrong = f"K has shape {K.shape} instead of (3, 3)"
    elif K[1, 0] != 0 or not np.array_equal(K[2], (0.0, 0.0, 1.0)):
        wrong = "K has numbers where [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] has none"
        to_do = "write it row by row, in pixels"
    elif not abs(K[0, 1]) <= LARGEST_SKEW * abs(K[0, 0]):
        wrong = f"K has a skew of {K[0, 1]:.5g}, and only cameras without one are taken"
        to_do = "calibrate the camera without skew, or take the K that it tells itself"
    elif not all(FOCAL_SHARES[0] * width < focal < FOCAL_SHARES[1] * width for focal in (K[0, 0], K[1, 1])):
        wrong = f"a focal length of {K[0, 0]:.5g}, {K[1, 1]:.5g} pixels does not go with a width of {width}"
    elif not (_is_middle(K[0, 2], width) and _is_middle(K[1, 2], height)):
        axis = f"({K[0, 2]:.5g}, {K[1, 2]:.5g})"
        wrong = f"the optical axis at {axis} is not near the middle of {width} x {height} pixels"
    elif distortion.size not in (0, 4, 5, 8, 12, 14):
        wrong = f"the distortion has {distortion.size} coefficients; OpenCV's 0, 4, 5, 8, 12 or 14 are taken"
    if wrong is not None:
        raise HandEyeInputError("intrinsics", f"the camera's matrix cannot be: {wrong}: {to_do}")


def _is_middle(at_px: float, size_px: int) -> bool:
    return AXIS_SHARES[0] * size_px < at_px < AXIS_SHARES[1] * size_px


def check_mounting(mounting: str) -> None:
    """Refuses what is no `Mounting`.

    Raises:
        HandEyeInputError: "mounting".
    """
    if mounting not in get_args(Mounting):
        raise HandEyeInputError(
            "mounting", f"the mounting is {mounting!r}: give {' or '.join(map(repr, get_args(Mounting)))}"
        )
