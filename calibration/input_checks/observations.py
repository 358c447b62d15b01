"""Check the observations before solving: invalid numbers, and views that do not determine the camera pose.

Each failed check raises a `HandEyeInputError`. Its `slug` is one of

    not-finite           NaN or infinity
    not-rigid            a pose is not a rigid transform: mirrored, scaled or sheared
    millimetres          a flange pose is too far from the base to be in metres
    degrees              a rotation vector is longer than a full rotation
    intrinsics           the camera matrix or the distortion is wrong
    mounting             the mounting is not "eye-in-hand" or "eye-to-hand"
    corners              the corner numbers are invalid, or do not match the pixels
    outside-image        a corner is outside the image
    repeated-names       two views have the same name
    too-few-views        fewer than `MIN_VIEWS` views
    too-few-corners      fewer than `MIN_VIEWS` views with enough corners
    duplicate-views      fewer than `MIN_VIEWS` different flange poses
    pure-translation     the robot hardly rotated
    parallel-axes        the robot rotated about one axis only
    camera-did-not-move  the robot rotated, but the board did not rotate in the camera frame

The checks from too-few-views to parallel-axes use all given views. After the solver has excluded outliers,
`calibration.assessment.acceptance` repeats too-few-views, pure-translation and parallel-axes with the used views.
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
"""Minimum number of views. With fewer views, an error in one view cannot be detected or averaged out."""
MAX_DISTANCE_M = 5.0
"""Maximum distance of the flange from the base, metres. A larger number is probably in millimetres."""
MIN_CAMERA_ROTATION_RAD = MIN_ROTATION_RAD / 3
"""Minimum of the largest rotation of the board in the camera frame, radians. A smaller rotation means that the robot
moved neither the camera nor the board. Other mistakes leave a larger rotation."""


def check_observations(observations: Observations) -> None:
    """Check that the observations are valid and determine a calibration.

    Raises:
        HandEyeInputError: A check failed. `slug` names the first failed check.
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
    """Check the view names, the mounting, the camera and each view. The number of views is not checked.

    Raises:
        HandEyeInputError: A check failed. `slug` names the first failed check.
    """
    _check_names([view.name for view in observations.views])
    check_mounting(observations.mounting)
    check_camera(observations.K, observations.distortion, observations.image_size)
    for view in observations.views:
        _check_pose(view.T_base_flange, f"view {view.name}: T_base_flange")
        _check_corners(view, observations)


def check_camera_moved(T_camera_board: NDArray[np.float64]) -> None:
    """Check that the board rotates in the camera frame.

    Call this function after `check_observations`, which checks that the robot rotated.

    Args:
        T_camera_board: (N, 4, 4) board poses in the camera frame.

    Raises:
        HandEyeInputError: All board rotations are nearly equal. `slug` is "camera-did-not-move".
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
    """Return whether corners determine a board pose: at least `MIN_CORNERS`, not all on one line.

    Args:
        ids: (N,) numbers of the corners.
        board: The board with the corners.
    """
    if len(ids) < MIN_CORNERS:
        return False
    points = board.points[ids]
    return int(np.linalg.matrix_rank(points - points.mean(axis=0), tol=0.1 * board.pitch_m)) == 2


def pose_from_vector(xyz_m: ArrayLike, rotvec_rad: ArrayLike, name: str = "T_base_flange") -> NDArray[np.float64]:
    """Convert a position and a rotation vector, as reported by a robot controller, to a pose.

    Args:
        xyz_m: (3,) position, metres.
        rotvec_rad: (3,) rotation vector, radians.
        name: Name of the pose in the error message.

    Returns:
        (4, 4) pose, metres.

    Raises:
        HandEyeInputError: The position or the rotation vector is not valid. `slug` is "not-rigid" (not three numbers),
            "not-finite", "degrees" or "millimetres".
    """
    position = _three_numbers(xyz_m, name)
    vector = _three_numbers(rotvec_rad, name)
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
    """Check that a flange position (3,) in the base frame is plausible in metres.

    Args:
        position: (3,) position, nominally metres.
        name: Name of the pose in the error message.

    Raises:
        HandEyeInputError: The distance from the base exceeds `MAX_DISTANCE_M`. `slug` is "millimetres".
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
    ids = np.asarray(view.ids)
    pixels = np.asarray(view.pixels, dtype=np.float64)
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
    """Check that the flange poses (N, 4, 4) are different enough, and that the rotations have two axes."""
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
