"""Input checks: observations go in, and a `HandEyeInputError` is raised if they do not determine a calibration.

`check_observations` checks the camera, each view and the robot motion before the board poses are estimated.
`check_camera_moved` checks the estimated board poses: the board must rotate in the camera frame.
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
