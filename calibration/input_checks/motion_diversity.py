"""How much, and about how many axes, the robot turned between views: what a hand-eye calibration lives on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PURE_TRANSLATION_RAD = np.radians(15.0)
"""Largest turn between two views below which the camera's place on the flange cannot be told from the board's."""
PARALLEL_AXES_RAD = np.radians(5.0)
"""Turning about the second axis below which the camera's place along the first one cannot be told."""


@dataclass(frozen=True)
class MotionDiversity:
    """Of a set of poses."""

    largest_rad: float
    """Between any two of them."""
    second_axis_rad: float
    """Root mean square turn, away from the mean, about the second strongest axis."""

    def too_little_words(self) -> str:
        """For a person, when `largest_rad` is too small."""
        return (
            f"the views differ by turns of at most {np.degrees(self.largest_rad):.1f} degrees, and "
            f"{np.degrees(PURE_TRANSLATION_RAD):.0f} are needed: add views from tilted and rolled poses, since moving "
            "without turning tells nothing of where the camera is on the flange"
        )

    def parallel_words(self) -> str:
        """For a person, when `second_axis_rad` is too small."""
        return (
            f"the robot turned about nearly one axis only: about the second one by "
            f"{np.degrees(self.second_axis_rad):.1f} degrees (rms), and {np.degrees(PARALLEL_AXES_RAD):.0f} are "
            "needed: add views tilted by 20 to 30 degrees to different sides"
        )


def motion_diversity(poses: NDArray[np.float64]) -> MotionDiversity:
    """The spread of poses (N, 4, 4), N >= 2; the same for `T_base_flange` and its inverse's views of it."""
    from scipy.spatial.transform import Rotation

    first, second = np.triu_indices(len(poses), k=1)
    R = poses[:, :3, :3]
    turns = Rotation.from_matrix(R[first].transpose(0, 2, 1) @ R[second]).as_rotvec()
    # Differences of two have twice the variance of one's deviation from the mean.
    variances = np.linalg.eigvalsh(turns.T @ turns / (2 * len(turns)))
    return MotionDiversity(
        largest_rad=float(np.linalg.norm(turns, axis=1).max()), second_axis_rad=float(np.sqrt(max(variances[1], 0.0)))
    )
