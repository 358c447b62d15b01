"""Diversity of the robot rotations between views. A hand-eye calibration needs rotations about two axes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_ROTATION_RAD = np.radians(15.0)
"""Minimum of `MotionDiversity.max_rotation_rad`, radians. With smaller rotations, the images do not distinguish the
camera position on the flange from the board position."""
MIN_SECOND_AXIS_RAD = np.radians(5.0)
"""Minimum of `MotionDiversity.second_axis_rad`, radians. With smaller rotations, the camera position along the first
axis is unknown."""


@dataclass(frozen=True)
class MotionDiversity:
    """Diversity of the rotations in a set of poses."""

    max_rotation_rad: float
    """Largest rotation angle between two poses, radians."""
    second_axis_rad: float
    """Standard deviation of the rotations about the second principal axis, radians."""

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
    """Compute the diversity of the rotations in a set of poses.

    `max_rotation_rad` is equal for a set of poses and for the inverse poses.

    Args:
        poses: (N, 4, 4) poses, N >= 2.
    """
    from scipy.spatial.transform import Rotation

    first, second = np.triu_indices(len(poses), k=1)
    R = poses[:, :3, :3]
    rotations = Rotation.from_matrix(R[first].transpose(0, 2, 1) @ R[second]).as_rotvec()
    # The rotation between two poses has twice the variance of the deviation of one pose from the mean.
    variances = np.linalg.eigvalsh(rotations.T @ rotations / (2 * len(rotations)))
    return MotionDiversity(
        max_rotation_rad=float(np.linalg.norm(rotations, axis=1).max()),
        second_axis_rad=float(np.sqrt(max(variances[1], 0.0))),
    )
