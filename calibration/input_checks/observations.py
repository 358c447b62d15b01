"""Checks of the observations before solving: invalid numbers, and views that cannot determine the camera pose.

Each refusal is a `HandEyeInputError`. Its `slug` is one of

    not-finite         NaN or infinity
    not-rigid          a pose is not a rigid transform: mirrored, scaled or sheared
    millimetres        a pose is too far away to be in metres
    degrees            a rotation vector is longer than a full rotation
    intrinsics         the camera matrix or the distortion is wrong, see `calibration.input_checks.camera`
    corners            the numbers and pixels of the corners do not match, or are not on the board
    outside-image      a corner is outside the image
    repeated-names     two views have the same name
    too-few-views      fewer than eight views
    too-few-corners    enough views, but too few with enough corners
    duplicate-views    enough views, but the robot did not move between them
    pure-translation   the robot hardly rotated
    parallel-axes      the robot rotated about one axis only
    mounting           neither eye-in-hand nor eye-to-hand
    camera-did-not-move
                       the robot rotated, and the camera saw the board as before

Those from too-few-views to parallel-axes are decided on all given views. `calibration.assessment.acceptance` decides
again on the views that agree.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import HandEyeInputError
from calibration.geometry.transforms import NotRigidError, from_rotation_vector, rigid
from calibration.input_checks.camera import check_camera, check_mounting
from calibration.input_checks.motion_diversity import MIN_ROTATION_RAD, MIN_SECOND_AXIS_RAD, motion_diversity
from calibration.observations import BoardView, Observations
from calibration.pose_estimation.duplicate_poses import group_equal_poses
from calibration.target.board import MIN_CORNERS, Board

MIN_VIEWS = 8
"""Minimum number of views. With fewer, an error in one view can be neither detected nor averaged out."""
MAX_DISTANCE_M = 5.0
"""Maximum distance of a flange from its base. Larger numbers are millimetres."""
MIN_CAMERA_ROTATION_RAD = MIN_ROTATION_RAD / 3
"""Rotation of the camera against the board below which the robot, which rotated enough, did not move the camera. Other
mistakes do not reduce the rotation to a third."""


def check_observations(observations: Observations) -> None:
    """Check that a calibration can be solved from the observations.

    Raises:
        HandEyeInputError: It cannot. `slug` is that of the first check that failed, and the message names the view.
    """
    check_each_view(observations)
    if len(observations.views) < MIN_VIEWS:
        raise HandEyeInputError(
            "too-few-views",
            f"there are {len(observations.views)} views of the board, and {MIN_VIEWS} are needed (12 to 15 are good): "
            "add views",
        )
    usable = [view for view in observations.views if enough_corners(view.ids, observations.board)]
    if len(usable) < MIN_VIEWS:
        raise HandEyeInputError(
            "too-few-corners",
            f"only {len(usable)} of {len(observations.views)} views show {MIN_CORNERS} corners of the board in more "
            f"than one row, and {MIN_VIEWS} are needed: bring the whole board into the image, sharp and evenly lit",
        )
    _check_motion(np.array([view.T_base_flange for view in usable]))


def check_each_view(observations: Observations) -> None:
    """Check the camera, and each view by itself, whatever the number of views.

    Raises:
        HandEyeInputError: One of them is wrong.
    """
    _check_names([view.name for view in observations.views])
    check_mounting(observations.mounting)
    check_camera(observations.K, observations.distortion, observations.image_size)
    for view in observations.views:
        _check_pose(view.T_base_flange, f"view {view.name}: T_base_flange")
        _check_corners(view, observations)


def check_camera_moved(T_camera_board: NDArray[np.float64]) -> None:
    """Check that the board rotated in the images of a robot that rotated.

    Args:
        T_camera_board: (N, 4, 4) board poses in the camera frame.

    Raises:
        HandEyeInputError: The board poses are all alike ("camera-did-not-move").
    """
    max_rotation_rad = motion_diversity(T_camera_board).max_rotation_rad
    if max_rotation_rad < MIN_CAMERA_ROTATION_RAD:
        raise HandEyeInputError(
            "camera-did-not-move",
            f"the robot rotated, but in the images the board rotates by {np.degrees(max_rotation_rad):.1f} degrees "
            "at most: check that the camera or the board is on the flange as the mounting says, and that each image "
            "is a new one",
        )


def enough_corners(ids: NDArray[np.int64], board: Board) -> bool:
    """Return whether corners are enough for a pose: at least `MIN_CORNERS`, and not all in one line.

    Args:
        ids: (N,) numbers of the corners.
        board: The board that they are on.
    """
    if len(ids) < MIN_CORNERS:
        return False
    points = board.points[ids]
    return int(np.linalg.matrix_rank(points - points.mean(axis=0), tol=0.1 * board.pitch_m)) == 2


def pose_from_vector(xyz_m: ArrayLike, rotvec_rad: ArrayLike, name: str = "T_base_flange") -> NDArray[np.float64]:
    """Return the pose (4, 4) that a controller reports as a position and a rotation vector.

    Args:
        xyz_m: (3,) position, metres.
        rotvec_rad: (3,) rotation vector, radians.
        name: Name of the pose in the error message.

    Raises:
        HandEyeInputError: They are not three numbers each ("not-rigid"), not finite ("not-finite"), in millimetres
            ("millimetres"), or in degrees ("degrees").
    """
    position, vector = (_three_numbers(values, name) for values in (xyz_m, rotvec_rad))
    angle = float(np.linalg.norm(vector))
    if angle > 2.0 * np.pi:
        raise HandEyeInputError(
            "degrees",
            f"{name} has a rotation vector of length {angle:.4g}, more than a full rotation (2 pi): give it in "
            "radians. These numbers look like degrees or like Euler angles",
        )
    check_in_metres(position, name)
    return from_rotation_vector(position, vector)


def check_in_metres(position: NDArray[np.float64], name: str) -> None:
    """Check that a position (3,) is near enough to be in metres.

    Raises:
        HandEyeInputError: It is not ("millimetres").
    """
    with np.errstate(over="ignore"):
        distance_m = float(np.linalg.norm(position))
    if distance_m > MAX_DISTANCE_M:
        raise HandEyeInputError(
            "millimetres",
            f"{name} is {distance_m:.4g} m away, more than {MAX_DISTANCE_M:g} m: give metres. These numbers look like "
            "millimetres",
        )


def _three_numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise HandEyeInputError("not-rigid", f"{name} does not consist of numbers: {error}") from error
    if numbers.shape != (3,):
        raise HandEyeInputError("not-rigid", f"{name} has shape {numbers.shape}, and three numbers are needed")
    if not np.isfinite(numbers).all():
        raise _not_finite(name)
    return numbers


def _check_pose(T: NDArray[np.float64], name: str) -> None:
    values = np.asarray(T, dtype=np.float64)
    if not np.isfinite(values).all():
        raise _not_finite(name)
    try:
        matrix = rigid(values, name)
    except NotRigidError as error:
        raise HandEyeInputError("not-rigid", str(error)) from error
    check_in_metres(matrix[:3, 3], name)


def _check_names(names: Sequence[str]) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise HandEyeInputError("repeated-names", f"more than one view has the name {repeated[0]}: give each its own")


def _check_corners(view: BoardView, observations: Observations) -> None:
    ids, pixels = np.asarray(view.ids), np.asarray(view.pixels, dtype=np.float64)
    width, height = observations.image_size
    count = len(observations.board.points)
    problem = None
    if pixels.shape != (len(ids), 2) or ids.ndim != 1:
        problem = f"numbers of corners with shape {ids.shape} and pixels with shape {pixels.shape} do not match"
    elif len(ids) and not (ids.min() >= 0 and ids.max() < count):
        problem = f"the corners {ids.min()} to {ids.max()} are not all on the board, which has {count}"
    elif len(np.unique(ids)) < len(ids):
        problem = "a corner occurs twice"
    if problem is not None:
        raise HandEyeInputError("corners", f"view {view.name}: {problem}: detect the board again")
    if not np.isfinite(pixels).all():
        raise _not_finite(f"view {view.name}: the pixels of the corners")
    if len(ids) and not ((pixels >= -0.5).all() and (pixels <= (width - 0.5, height - 0.5)).all()):
        worst = pixels[np.argmax(np.abs(pixels - (width / 2, height / 2)).max(axis=1))]
        raise HandEyeInputError(
            "outside-image",
            f"view {view.name}: a corner at ({worst[0]:.1f}, {worst[1]:.1f}) is outside the image of {width} x "
            f"{height} pixels: give the size of the images in which the corners were detected",
        )


def _check_motion(T_base_flange: NDArray[np.float64]) -> None:
    """Check that the robot stood in enough poses, and rotated enough about more than one axis."""
    different = len(np.unique(group_equal_poses(T_base_flange)))
    if different < MIN_VIEWS:
        raise HandEyeInputError(
            "duplicate-views",
            f"the robot had only {different} different poses for {len(T_base_flange)} views, and {MIN_VIEWS} are "
            "needed: move it between images, and read its pose again for each",
        )
    diversity = motion_diversity(T_base_flange)
    if diversity.max_rotation_rad < MIN_ROTATION_RAD:
        raise HandEyeInputError("pure-translation", diversity.pure_translation_message())
    if diversity.second_axis_rad < MIN_SECOND_AXIS_RAD:
        raise HandEyeInputError("parallel-axes", diversity.parallel_axes_message())


def _not_finite(name: str) -> HandEyeInputError:
    return HandEyeInputError("not-finite", f"{name} holds NaN or infinity: read it again")
