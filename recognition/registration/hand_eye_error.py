"""Estimate of the hand-eye error from one scan. All views of the scan share this error."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.registration.multiview_icp import Alignment
from recognition.registration.pose_prior import PoseSigmas


@dataclass(frozen=True, eq=False)
class HandEyeErrorEstimate:
    """Gaussian likelihood of the hand-eye error `c` (6,), in information form.

    `c` is a rotation vector and a translation in the camera frame, radians and metres:
    `T_flange_camera_true = T_flange_camera @ from_rotation_vector(c[3:], c[:3])`.

    The prior is not included, so that the estimates of several scans can be added. Strings constrain the error weakly:
    in some directions there may be almost no information.
    """

    information: NDArray[np.float64]
    """(6, 6) inverse covariance of c, marginalised over the robot errors and the disparity offset."""
    vector: NDArray[np.float64]
    """(6,) information vector: `information @ c` at the most likely c."""
    posterior_mean: NDArray[np.float64]
    """(6,) the most probable c with the prior included. The registered poses were corrected by it."""


def estimate_hand_eye_error(alignment: Alignment, sigmas: PoseSigmas) -> HandEyeErrorEstimate | None:
    """Return the hand-eye error that the surfaces of the views show, without the prior.

    Args:
        alignment: The solution for all poses.
        sigmas: The prior with which `alignment` was computed.

    Returns:
        The estimate; None if no surface constrained the poses.
    """
    posterior_information = alignment.hand_eye_information
    if posterior_information is None:
        return None
    # The prior's mean is zero, so that the whole information vector is from the views.
    vector = posterior_information @ alignment.hand_eye_error
    information = posterior_information - sigmas.shared_information[:-1, :-1]
    return HandEyeErrorEstimate(
        information=(information + information.T) / 2, vector=vector, posterior_mean=alignment.hand_eye_error
    )
