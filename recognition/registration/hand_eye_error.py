"""Estimate the hand-eye error, which all views share, from one scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.registration.multiview_icp import Alignment
from recognition.registration.pose_prior import N_DISPARITY, PoseSigmas


@dataclass(frozen=True, eq=False)
class HandEyeErrorEstimate:
    """Gaussian likelihood of the hand-eye error `c` (6,), in information form.

    `c` is a rotation vector (rad), then a translation (m), in the camera frame:
    `T_flange_camera_true = T_flange_camera @ from_rotation_vector(translation=c[3:], rotation_vector=c[:3])`.

    The likelihood does not include the prior. `information` and `vector` of several scans can therefore be added. A
    scan of strings constrains the error weakly: some directions may have almost no information.
    """

    information: NDArray[np.float64]
    """(6, 6) information matrix (inverse covariance) of `c`, marginalised over robot errors and disparity error."""
    vector: NDArray[np.float64]
    """(6,) information vector, the product of `information` and the maximum likelihood estimate of `c`."""
    posterior_mean: NDArray[np.float64]
    """(6,) maximum a posteriori estimate of `c`, which includes the prior. The registered poses include this
    correction."""


def estimate_hand_eye_error(alignment: Alignment, sigmas: PoseSigmas) -> HandEyeErrorEstimate | None:
    """Estimate the hand-eye error from the surfaces of the views, without the prior.

    Args:
        alignment: Aligned poses of all views.
        sigmas: Prior standard deviations with which `alignment` was computed.

    Returns:
        The estimate; None if no surface constrained the poses.
    """
    posterior_information = alignment.hand_eye_information
    if posterior_information is None:
        return None
    # The prior has zero mean, so it adds nothing to the information vector.
    vector = posterior_information @ alignment.hand_eye_error
    information = posterior_information - sigmas.shared_information[:-N_DISPARITY, :-N_DISPARITY]
    return HandEyeErrorEstimate(
        information=(information + information.T) / 2, vector=vector, posterior_mean=alignment.hand_eye_error
    )
