"""Pose of the board in each image: corners with the camera matrix go in, board poses come out.

`projection` models the camera. `board_pose` estimates one board pose per view. `corner_disambiguation` makes the corner
numbers of a symmetric board consistent. `duplicate_poses` finds views that were taken at the same robot pose.
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
