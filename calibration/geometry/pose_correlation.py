"""Correlation of the errors of an arm at different poses.

Errors of the link lengths, joint offsets and elasticity make an arm deviate from its reported pose by nearly the same
amount in neighbouring poses. The model is a Gaussian process over the poses. Two poses with the distance p and the
rotation angle q have the correlation

    exp(-p^2 / (2 LENGTH_M^2) - q^2 / (2 LENGTH_RAD^2)).
"""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import rotation_angles

LENGTH_M = 0.4
"""Distance of positions over which the error changes noticeably, metres: half the reach of a small arm."""
LENGTH_RAD = 1.0
"""Angle between orientations over which the error changes noticeably, radians."""


def pose_correlation(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the correlation (N, N) of the errors at the poses `T` (N, 4, 4) of the flange, or of its camera."""
    R = T[:, :3, :3]
    p = T[:, :3, 3]
    squares = ((p[:, None] - p) ** 2).sum(axis=2) / LENGTH_M**2 + rotation_angles(
        R[:, None].swapaxes(-1, -2) @ R[None]
    ) ** 2 / LENGTH_RAD**2
    return np.asarray(np.exp(-squares / 2), dtype=np.float64)
