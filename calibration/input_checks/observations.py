"""What is refused before solving: numbers that cannot be, and views that cannot tell where the camera is.

Each refusal is a `HandEyeInputError` whose `slug` is one of

    unpaired           flange poses, board poses and names are not equally many
    not-finite         NaN or infinity
    not-rigid          a pose that is no rigid transform: mirrored, scaled, sheared
    millimetres        a pose too far away to be in metres
    degrees            a rotation vector longer than a turn
    intrinsics         a camera matrix or distortion that cannot be, by `calibration.input_checks.camera`
    corners            numbers and pixels of corners that do not go together, or are not on the board
    outside-image      pixels outside the image
    repeated-names     two views of one name
    too-few-views      fewer than eight
    too-few-corners    enough views, but too few with enough corners
    duplicate-views    enough views, but the robot did not move between them
    pure-translation   the robot hardly turned
    parallel-axes      it turned about one axis only
    mounting           neither eye-in-hand nor eye-to-hand
    camera-did-not-move
                       the robot turned, and the camera saw the board as before

Those from too-few-views to parallel-axes are decided on all views given; `calibration.assessment.acceptance` decides
again on those that fit one another.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.errors import HandEyeInputError
from calibration.geometry.transforms import NotRigidError, from_rotation_vector, rigid
from calibration.input_checks.camera import check_camera, check_mounting
from calibration.input_checks.motion_diversity import PARALLEL_AXES_RAD, PURE_TRANSLATION_RAD, motion_diversity
from calibration.observations import BoardView, Observations
from calibration.pose_estimation.duplicate_poses import number_poses
from calibration.target.board import FEWEST_CORNERS, Board

FEWEST_VIEWS = 8
"""With fewer, an error in one view can neither be seen nor be averaged away."""
FARTHEST_M = 5.0
"""No flange is farther from its base, and no board that can be read from the camera; larger numbers are millimetres."""
CAMERA_STILL_RAD = PURE_TRANSLATION_RAD / 3
"""A camera that turned less than this against the board, while the robot turned enough, was not moved by it: no other
mistake makes it a third."""


def check_observations(observations: Observations) -> None:
    """Refuses observations that no calibration can be solved from.

    Raises:
        HandEyeInputError: with the slug of the first check that failed; the words name the view.
    """
    check_each(observations)
    if len(observations.views) < FEWEST_VIEWS:
        raise _too_few_views(len(observations.views))
    usable = [view for view in observations.views if enough_corners(view.ids, observations.board)]
    if len(usable) < FEWEST_VIEWS:
        raise HandEyeInputError(
            "too-few-corners",
            f"only {len(usable)} of {len(observations.views)} views show {FEWEST_CORNERS} corners of the board in more "
            f"than one row, and {FEWEST_VIEWS} are needed: bring the board wholly into the picture, sharp and evenly "
            "lit",
        )
    _check_spread(np.array([view.T_base_flange for view in usable]))


def check_each(observations: Observations) -> None:
    """Refuses a camera, and views, that cannot be, however many there are. Raises HandEyeInputError."""
    _check_names([view.name for view in observations.views])
    check_mounting(observations.mounting)
    check_camera(observations.K, observations.distortion, observations.image_size)
    for view in observations.views:
        _check_pose(view.T_base_flange, f"view {view.name}: T_base_flange")
        _check_corners(view, observations)


def check_poses(
    T_base_flange: NDArray[np.float64], T_camera_board: NDArray[np.float64], names: tuple[str, ...] | None = None
) -> None:
    """Refuses poses (N, 4, 4) that no calibration can be solved from; `names` (N,) are the views', else their numbers.

    Raises:
        HandEyeInputError: with the slug of the first check that failed; the words name the view.
    """
    if len(T_base_flange) != len(T_camera_board):
        raise HandEyeInputError(
            "unpaired",
            f"there are {len(T_base_flange)} flange poses and {len(T_camera_board)} board poses: one of each is "
            "needed for every view",
        )
    if names and len(names) != len(T_base_flange):
        raise HandEyeInputError(
            "unpaired", f"there are {len(names)} names and {len(T_base_flange)} poses: one is needed for every view"
        )
    names = names or tuple(str(index) for index in range(len(T_base_flange)))
    _check_names(names)
    for name, flange, board in zip(names, T_base_flange, T_camera_board, strict=True):
        _check_pose(flange, f"view {name}: T_base_flange")
        _check_pose(board, f"view {name}: T_camera_board")
    if len(T_base_flange) < FEWEST_VIEWS:
        raise _too_few_views(len(T_base_flange))
    _check_spread(np.asarray(T_base_flange, dtype=np.float64))
    check_camera_moved(np.asarray(T_camera_board, dtype=np.float64))


def check_camera_moved(T_camera_board: NDArray[np.float64]) -> None:
    """Refuses board poses (N, 4, 4) that are all alike, of views between which the robot turned.

    Raises:
        HandEyeInputError: "camera-did-not-move".
    """
    largest_rad = motion_diversity(T_camera_board).largest_rad
    if largest_rad < CAMERA_STILL_RAD:
        raise HandEyeInputError(
            "camera-did-not-move",
            f"the robot turned, and in the pictures the board turns by {np.degrees(largest_rad):.1f} degrees at most: "
            "check that camera or board is on the flange as the mounting says, and that each picture is a new one",
        )


def enough_corners(ids: NDArray[np.int64], board: Board) -> bool:
    """Whether the corners `ids` (N,) of `board` are enough for a pose: `FEWEST_CORNERS`, not all in one line."""
    if len(ids) < FEWEST_CORNERS:
        return False
    points = board.points[ids]
    return int(np.linalg.matrix_rank(points - points.mean(axis=0), tol=0.1 * board.pitch_m)) == 2


def pose_from_vector(xyz_m: ArrayLike, rotvec_rad: ArrayLike, name: str = "T_base_flange") -> NDArray[np.float64]:
    """The pose (4, 4) that a controller gives as a place (3,), metres, and a rotation vector (3,), radians.

    Raises:
        HandEyeInputError: not three numbers each ("not-rigid"), "not-finite", "millimetres", or a vector that can
            only be "degrees".
    """
    place, vector = (_three_numbers(values, name) for values in (xyz_m, rotvec_rad))
    turn = float(np.linalg.norm(vector))
    if turn > 2.0 * np.pi:
        raise HandEyeInputError(
            "degrees",
            f"{name} has a rotation vector of length {turn:.4g}, more than a turn (2 pi): rotation vectors are in "
            "radians, and this one looks like degrees or like Euler angles",
        )
    check_near(place, name)
    return from_rotation_vector(place, vector)


def _three_numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        numbers = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise HandEyeInputError("not-rigid", f"{name} is not made of numbers: {error}") from error
    if numbers.shape != (3,):
        raise HandEyeInputError("not-rigid", f"{name} has shape {numbers.shape} where three numbers are needed")
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
    check_near(matrix[:3, 3], name)


def check_near(place: NDArray[np.float64], name: str) -> None:
    """Refuses a place (3,) that is too far away to be in metres. Raises HandEyeInputError ("millimetres")."""
    with np.errstate(over="ignore"):
        far = float(np.linalg.norm(place))
    if far > FARTHEST_M:
        raise HandEyeInputError(
            "millimetres",
            f"{name} is {far:.4g} m away, and up to {FARTHEST_M:g} m is taken: metres are needed, and these look like "
            "millimetres",
        )


def _check_names(names: list[str] | tuple[str, ...]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise HandEyeInputError("repeated-names", f"more than one view is named {twice[0]}: give each its own name")


def _check_corners(view: BoardView, observations: Observations) -> None:
    ids, pixels = np.asarray(view.ids), np.asarray(view.pixels, dtype=np.float64)
    width, height = observations.image_size
    count = len(observations.board.points)
    wrong = None
    if pixels.shape != (len(ids), 2) or ids.ndim != 1:
        wrong = f"{ids.shape} numbers of corners and {pixels.shape} pixels do not go together"
    elif len(ids) and not (ids.min() >= 0 and ids.max() < count):
        wrong = f"the corners {ids.min()} to {ids.max()} are not all on the board, which has {count}"
    elif len(np.unique(ids)) < len(ids):
        wrong = "a corner is there twice"
    if wrong is not None:
        raise HandEyeInputError("corners", f"view {view.name}: {wrong}: detect the board anew")
    if not np.isfinite(pixels).all():
        raise _not_finite(f"view {view.name}: the corners' pixels")
    if len(ids) and not ((pixels >= -0.5).all() and (pixels <= (width - 0.5, height - 0.5)).all()):
        worst = pixels[np.argmax(np.abs(pixels - (width / 2, height / 2)).max(axis=1))]
        raise HandEyeInputError(
            "outside-image",
            f"view {view.name}: a corner at ({worst[0]:.1f}, {worst[1]:.1f}) is outside the image of {width} x "
            f"{height} pixels: give the size of the pictures that the corners were found in",
        )


def _check_spread(T_base_flange: NDArray[np.float64]) -> None:
    different = len(np.unique(number_poses(T_base_flange)))
    if different < FEWEST_VIEWS:
        raise HandEyeInputError(
            "duplicate-views",
            f"the robot stood in only {different} different poses for {len(T_base_flange)} views, and {FEWEST_VIEWS} "
            "are needed: move it between pictures, and read its pose anew for each",
        )
    spread = motion_diversity(T_base_flange)
    if spread.largest_rad < PURE_TRANSLATION_RAD:
        raise HandEyeInputError("pure-translation", spread.too_little_words())
    if spread.second_axis_rad < PARALLEL_AXES_RAD:
        raise HandEyeInputError("parallel-axes", spread.parallel_words())


def _too_few_views(count: int) -> HandEyeInputError:
    return HandEyeInputError(
        "too-few-views",
        f"there are {count} views of the board, and {FEWEST_VIEWS} are needed (12 to 15 are good): add views",
    )


def _not_finite(name: str) -> HandEyeInputError:
    return HandEyeInputError("not-finite", f"{name} holds NaN or infinity: read it anew")
