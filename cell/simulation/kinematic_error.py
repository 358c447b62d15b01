"""The difference between the pose that an arm reports and the pose by its nominal kinematics.

A real controller computes the flange pose with the calibrated dimensions of its own arm. The result differs from
nominal kinematics by 0.3 to 1.2 mm and 0.09 to 0.21 degrees root mean square, smoothly with the pose.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector

WAVES = 8
"""Number of cosines that each component is a sum of."""
LENGTH_M = 0.4
"""Distance over which the error changes noticeably."""
ROTATION_SHARE = 0.7
"""Weight of the orientation, as the elements of its matrix, beside the position in units of `LENGTH_M`."""


class KinematicError:
    """A smooth pose error of one arm, drawn from a seed.

    Each of the six components is a sum of `WAVES` cosines of the position and the orientation. Over the workspace and
    the seeds, the translation and the rotation have the given root mean squares.
    """

    def __init__(self, rms_m: float, rms_rad: float, seed: int) -> None:
        """Draw the error of one arm.

        Args:
            rms_m: Root mean square of the translation's length.
            rms_rad: Root mean square of the rotation's angle.
            seed: Seed of the arm. The same seed gives the same error.
        """
        rng = np.random.default_rng(seed)
        self._frequency = rng.standard_normal((WAVES, 12)) * ([1 / LENGTH_M] * 3 + [ROTATION_SHARE] * 9)
        self._phase = rng.uniform(0.0, 2 * np.pi, WAVES)
        scale = np.array([rms_m] * 3 + [rms_rad] * 3) / np.sqrt(3.0) * np.sqrt(2.0 / WAVES)
        self._weight = rng.standard_normal((WAVES, 6)) * scale

    def apply(self, T: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the reported pose (4, 4) for the nominal pose `T` (4, 4)."""
        features = np.concatenate([T[:3, 3], T[:3, :3].ravel()])
        error = np.cos(self._frequency @ features + self._phase) @ self._weight
        turned = from_rotation_vector((0.0, 0.0, 0.0), error[3:])
        result = np.eye(4)
        result[:3, :3] = turned[:3, :3] @ T[:3, :3]
        result[:3, 3] = T[:3, 3] + error[:3]
        return result
