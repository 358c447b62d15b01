"""Input checks: observations go in, and a `HandEyeInputError` comes out if no calibration can be solved from them.

`check_observations` checks the camera, each view and the motion of the robot before anything is solved.
`check_camera_moved` checks afterwards that the board moved in the images when the robot rotated.
"""

from calibration.input_checks.camera import check_camera
from calibration.input_checks.motion_diversity import MotionDiversity, motion_diversity
from calibration.input_checks.observations import (
    check_camera_moved,
    check_each_view,
    check_in_metres,
    check_observations,
    enough_corners,
    pose_from_vector,
)

__all__ = [
    "MotionDiversity",
    "check_camera",
    "check_camera_moved",
    "check_each_view",
    "check_in_metres",
    "check_observations",
    "enough_corners",
    "motion_diversity",
    "pose_from_vector",
]
