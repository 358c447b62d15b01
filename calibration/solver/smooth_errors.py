"""Smooth robot errors: the part of the robot error that changes slowly with the flange pose.

The model is the Gaussian process of `calibration.geometry.pose_correlation` over the flange poses, with independent
components of the rotation and the translation in the base frame.

The leading eigenvectors of the correlation matrix, times the roots of their eigenvalues, span the process: the smooth
errors are a weighted sum of these modes, and the weights are independent unknowns with equal variance.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.pose_correlation import pose_correlation

MAX_MODES = 12
"""Maximum number of modes."""
MIN_MODE_SHARE = 1e-3
"""Minimum ratio of the variance of a mode to the variance of all modes."""


def smooth_modes(T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Jacobian of the robot errors with respect to the weights of the smooth modes.

    Args:
        T_base_flange: (N, 4, 4) reported flange poses, metres.

    Returns:
        (N, 6, 6 M) Jacobian of M modes. A robot error is a twist in the flange frame: rotation (rad), then translation
        (m). Each mode has six weights: rotation (rad), then translation (m), in the base frame.
    """
    R = T_base_flange[:, :3, :3]
    values, vectors = np.linalg.eigh(pose_correlation(T_base_flange))
    leading = np.flatnonzero(values > MIN_MODE_SHARE * len(R))[-MAX_MODES:]
    modes = vectors[:, leading] * np.sqrt(values[leading])
    to_flange = np.zeros((len(R), 6, 6))
    to_flange[:, :3, :3] = to_flange[:, 3:, 3:] = R.swapaxes(1, 2)
    return (to_flange[:, :, None] * modes[:, None, :, None]).reshape(len(R), 6, -1)
