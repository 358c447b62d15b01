"""Pose of the board in each image: corners with the camera matrix go in, (4, 4) board poses come out.

`projection` models the camera, `board_pose` fits one pose per view, and `corner_disambiguation` makes the numbering of
symmetric boards consistent. `duplicate_poses` finds views that were taken from the same robot pose.
"""

from calibration.pose_estimation.board_pose import BoardPoses, estimate_board_poses
from calibration.pose_estimation.corner_disambiguation import make_numbering_consistent, renumber_to_prediction
from calibration.pose_estimation.projection import Corners, stack_corners

__all__ = [
    "BoardPoses",
    "Corners",
    "estimate_board_poses",
    "make_numbering_consistent",
    "renumber_to_prediction",
    "stack_corners",
]
