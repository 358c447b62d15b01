"""Smooth robot errors: the part of the robot error that changes slowly with the flange pose.

Errors of the link lengths, joint offsets and elasticity make an arm deviate from its reported pose by nearly the same
amount in neighbouring poses. The model is a Gaussian process over the flange poses, with independent components of the
rotation and the translation in the base frame. Two poses with the distance p and the rotation angle q have the
correlation

    exp(-p^2 / (2 LENGTH_M^2) - q^2 / (2 LENGTH_RAD^2)).

The leading eigenvectors of the correlation matrix, times the roots of their eigenvalues, span the process: the smooth
errors are a weighted sum of these modes, and the weights are independent unknowns with equal variance.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import rotation_angles

LENGTH_M = 0.4
"""Distance of flange positions over which the error changes noticeably, metres: half the reach of a small arm."""
LENGTH_RAD = 1.0
"""Angle between flange orientations over which the error changes noticeably, radians."""
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
    R, p = T_base_flange[:, :3, :3], T_base_flange[:, :3, 3]
    squares = ((p[:, None] - p) ** 2).sum(axis=2) / LENGTH_M**2 + rotation_angles(
        R[:, None].swapaxes(-1, -2) @ R[None]
    ) ** 2 / LENGTH_RAD**2
    values, vectors = np.linalg.eigh(np.exp(-squares / 2))
    leading = np.flatnonzero(values > MIN_MODE_SHARE * len(p))[-MAX_MODES:]
    modes = vectors[:, leading] * np.sqrt(values[leading])
    to_flange = np.zeros((len(p), 6, 6))
    to_flange[:, :3, :3] = to_flange[:, 3:, 3:] = R.swapaxes(1, 2)
    return (to_flange[:, :, None] * modes[:, None, :, None]).reshape(len(p), 6, -1)
