"""What one scan tells of the hand-eye calibration's error, which all its views share."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.registration.multiview_icp import Alignment
from recognition.registration.pose_prior import PoseSigmas


@dataclass(frozen=True, eq=False)
class HandEyeErrorEstimate:
    """The likelihood of the calibration's error `c` (6,), a rotation vector and a translation in the camera's frame,
    `T_flange_camera_true = T_flange_camera @ from_rotation_vector(c[3:], c[:3])`; radians and metres.

    What is known of it beforehand is not in it, so that scans can be put together. Strings constrain little: in some
    directions there may be next to no information.
    """

    information: NDArray[np.float64]
    """(6, 6) inverse covariance, whatever the robot's errors and the disparity offset are."""
    vector: NDArray[np.float64]
    """(6,) `information @ c` at the likeliest c."""
    likeliest: NDArray[np.float64]
    """(6,) c with what is known beforehand: what the registered poses were corrected by."""


def estimate_hand_eye_error(alignment: Alignment, sigmas: PoseSigmas) -> HandEyeErrorEstimate | None:
    """What `alignment`, which was made with `sigmas`, tells; None where no surface held it."""
    information = alignment.calibration_information
    if information is None:
        return None
    # Beforehand the error is most likely nought, so that all of the vector is the views'.
    vector = information @ alignment.calibration
    told = information - np.diag(np.repeat([sigmas.hand_eye_rad, sigmas.hand_eye_m], 3) ** -2.0)
    return HandEyeErrorEstimate((told + told.T) / 2, vector, alignment.calibration)
