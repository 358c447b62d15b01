"""Diversity of the robot's rotations between views, on which a hand-eye calibration depends."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_ROTATION_RAD = np.radians(15.0)
"""Minimum of the largest rotation between two views. With less, the position of the camera on the flange cannot be
distinguished from that of the board."""
MIN_SECOND_AXIS_RAD = np.radians(5.0)
"""Minimum rotation about the second axis. With less, the position of the camera along the first axis is unknown."""


@dataclass(frozen=True)
class MotionDiversity:
    """Spread of the rotations of a set of poses."""

    max_rotation_rad: float
    """Largest rotation between two of the poses, radians."""
    second_axis_rad: float
    """Rotation about the second strongest axis, radians, root mean square of the deviation from the mean."""

    def pure_translation_message(self) -> str:
        """Return the message for a `max_rotation_rad` that is too small."""
        return (
            f"the largest rotation between two views is {np.degrees(self.max_rotation_rad):.1f} degrees, and "
            f"{np.degrees(MIN_ROTATION_RAD):.0f} are needed: add views from tilted and rolled poses. Motion without "
            "rotation does not show where the camera is on the flange"
        )

    def parallel_axes_message(self) -> str:
        """Return the message for a `second_axis_rad` that is too small."""
        return (
            f"the robot rotated about nearly one axis only. The rotation about the second axis is "
            f"{np.degrees(self.second_axis_rad):.1f} degrees (rms), and {np.degrees(MIN_SECOND_AXIS_RAD):.0f} are "
            "needed: add views that are tilted by 20 to 30 degrees to different sides"
        )


def motion_diversity(poses: NDArray[np.float64]) -> MotionDiversity:
    """Return the spread of the rotations of poses (N, 4, 4), N at least 2.

    Poses of the flange and their inverses have the same `max_rotation_rad`.
    """
    from scipy.spatial.transform import Rotation

    first, second = np.triu_indices(len(poses), k=1)
    R = poses[:, :3, :3]
    rotations = Rotation.from_matrix(R[first].transpose(0, 2, 1) @ R[second]).as_rotvec()
    # The difference of two has twice the variance of the deviation of one from the mean.
    variances = np.linalg.eigvalsh(rotations.T @ rotations / (2 * len(rotations)))
    return MotionDiversity(
        max_rotation_rad=float(np.linalg.norm(rotations, axis=1).max()),
        second_axis_rad=float(np.sqrt(max(variances[1], 0.0))),
    )
