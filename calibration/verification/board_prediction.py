"""Prediction of the board pose from a calibration, and comparison with the board poses observed in new views."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.errors import HandEyeInvalidError, HandEyeMismatchError
from calibration.geometry.se3 import adjoint, invert_poses
from calibration.input_checks.observations import MIN_VIEWS
from calibration.observations import Observations
from calibration.pose_estimation.board_pose import MIN_NOISE_PX, estimate_board_poses
from calibration.pose_estimation.corner_disambiguation import renumber_to_prediction
from calibration.pose_estimation.projection import N_CORRECTIONS, pixel_normal_equations, stack_corners
from calibration.result import HandEyeResult
from calibration.solver.initialisation import equation_poses
from calibration.solver.noise import NoisePriors
from calibration.storage.hand_eye_file import HandEye, require_match
from calibration.target.board import Board

MAX_FOCAL_DIFFERENCE = 0.05
"""Maximum relative difference between the focal lengths of the calibration and of the new views.

A larger difference means that the images have different sizes.
"""

ValueT = TypeVar("ValueT")


@dataclass(frozen=True, eq=False)
class PredictedBoard:
    """Board pose predicted by a calibration, with the uncertainty of the prediction."""

    X: NDArray[np.float64]
    """(4, 4) camera pose, metres: `T_flange_camera` (eye-in-hand) or `T_base_camera` (eye-to-hand)."""
    Y: NDArray[np.float64]
    """(4, 4) board pose during the calibration, metres: `T_base_board` (eye-in-hand) or `T_flange_board`
    (eye-to-hand)."""
    covariance: NDArray[np.float64]
    """(C, C) covariance of the errors of X, Y, lens and board scale, in the order of `HandEyeResult.joint_covariance`
    (C = 17). Some calibration files have only the block of X and Y (C = 12), or of X (C = 6)."""
    K: NDArray[np.float64]
    """(3, 3) fitted pinhole matrix, pixels."""
    board_scale: float
    """Estimated size of the board divided by its nominal size."""
    robot_sigma_m: float
    """Standard deviation of the robot position error per axis, metres."""
    robot_sigma_rad: float
    """Standard deviation of the robot rotation error per axis, radians."""
    views_used: int
    """Number of views from which the calibration and its noise were estimated."""


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """Deviation of the board pose observed in one view from the predicted board pose.

    Deviations are in the axes of the base frame (eye-in-hand) or of the flange frame (eye-to-hand).
    """

    deviation: NDArray[np.float64]
    """(6,) rotation vector (rad), then translation of the middle of the board (m)."""
    J_prediction: NDArray[np.float64]
    """(6, C) Jacobian of `deviation` with respect to the errors in `PredictedBoard.covariance`."""
    own_covariance: NDArray[np.float64]
    """(6, 6) covariance of `deviation` due to the robot error and the corner noise of this view."""


def predict_board(hand_eye: HandEye | HandEyeResult) -> PredictedBoard:
    """Return the board pose that a calibration predicts.

    Args:
        hand_eye: A solved calibration, or a calibration read from a file.

    Raises:
        HandEyeInvalidError: The file has no board pose, no covariance or no camera matrix.
    """
    # The joint covariance excludes the uncertainty of an unverified board size. Views cannot show this error.
    if isinstance(hand_eye, HandEyeResult):
        return PredictedBoard(
            X=hand_eye.X,
            Y=hand_eye.Y,
            covariance=hand_eye.joint_covariance,
            K=hand_eye.K,
            board_scale=hand_eye.board_scale,
            robot_sigma_m=hand_eye.robot_sigma_m,
            robot_sigma_rad=hand_eye.robot_sigma_rad,
            views_used=sum(view.used for view in hand_eye.views),
        )
    if hand_eye.T_base_board is None or hand_eye.covariance is None or hand_eye.K is None:
        raise HandEyeInvalidError(
            "the calibration cannot be verified: its file lacks the pose of the board, the covariance or the camera "
            "matrix. Calibrate again"
        )
    priors = NoisePriors()
    return PredictedBoard(
        X=hand_eye.T_flange_camera,
        Y=hand_eye.T_base_board,
        covariance=_or_default(hand_eye.joint_covariance, hand_eye.covariance),
        K=hand_eye.K,
        board_scale=_or_default(hand_eye.board_scale, 1.0),
        robot_sigma_m=_or_default(hand_eye.robot_sigma_m, priors.robot_m),
        robot_sigma_rad=_or_default(hand_eye.robot_sigma_rad, priors.robot_rad),
        views_used=_or_default(hand_eye.views_used, MIN_VIEWS),
    )


def _or_default(value: ValueT | None, default: ValueT) -> ValueT:
    """Return `value`, or `default` if the file does not have the value."""
    return default if value is None else value


def observe_board(predicted: PredictedBoard, views: Observations) -> tuple[list[str], list[BoardObservation]]:
    """Compare the board pose in each view with the predicted board pose.

    The corners of a symmetric board are renumbered so that the rotation from the predicted pose is smallest.

    Args:
        predicted: Board pose predicted by the calibration.
        views: New views of the board. Views without a board pose are skipped.

    Returns:
        Names of the views with a board pose, and one observation for each name.

    Raises:
        HandEyeMismatchError: The focal length of the views differs from the calibration, for example because the images
            have another resolution.
    """
    if np.abs(predicted.K[[0, 1], [0, 1]] / views.K[[0, 1], [0, 1]] - 1).max() > MAX_FOCAL_DIFFERENCE:
        raise HandEyeMismatchError(
            f"the calibration was made with images of a focal length of {predicted.K[0, 0]:.0f} px, these have "
            f"{views.K[0, 0]:.0f} px: set the camera to the resolution of the calibration, or calibrate again"
        )
    T_camera = equation_poses(views.T_base_flange, views.mounting) @ predicted.X
    views = renumber_to_prediction(views, invert_poses(T_camera) @ predicted.Y)
    # Undistort the corners with the given intrinsics, then project with the fitted camera matrix.
    nominal = stack_corners(views)
    corners = replace(nominal, K=predicted.K, points=predicted.board_scale * nominal.points)
    poses = estimate_board_poses(corners)
    information = pixel_normal_equations(poses.T_camera_board, np.zeros(N_CORRECTIONS), corners, poses.inliers).H
    # Deviations are in the base frame (eye-in-hand) or in the flange frame (eye-to-hand).
    T_flange = views.T_base_flange
    if views.mounting == "eye-to-hand":
        T_flange = np.tile(np.eye(4), (len(T_flange), 1, 1))
    names = []
    observations = []
    for k in np.flatnonzero(poses.found):
        seen = _SeenBoard(
            T_camera=T_camera[k],
            T_flange=T_flange[k],
            T_board=T_camera[k] @ poses.T_camera_board[k],
            information=information[k],
            pixel_px=max(float(poses.rms_px[k]), MIN_NOISE_PX),
        )
        names.append(views.views[k].name)
        observations.append(_compare(seen, predicted, corners.middle))
    return names, observations


@dataclass(frozen=True, eq=False)
class _SeenBoard:
    """Board pose estimated from one view. The poses are in the frame of the deviations (see `BoardObservation`)."""

    T_camera: NDArray[np.float64]
    """(4, 4) camera pose by the calibration, metres."""
    T_flange: NDArray[np.float64]
    """(4, 4) flange pose reported by the robot, metres."""
    T_board: NDArray[np.float64]
    """(4, 4) board pose, metres."""
    information: NDArray[np.float64]
    """Information matrix of board motion and corrections, as `PixelNormalEquations.H` of one view."""
    pixel_px: float
    """Standard deviation of the corner noise, pixels."""


def _compare(seen: _SeenBoard, predicted: PredictedBoard, middle_of_board: NDArray[np.float64]) -> BoardObservation:
    """Compare the board pose in one view with the prediction, at the middle (3,) of the board."""
    middle = seen.T_board[:3, :3] @ middle_of_board + seen.T_board[:3, 3]
    predicted_middle = predicted.Y[:3, :3] @ middle_of_board + predicted.Y[:3, 3]
    rotation = _rotation_vector(seen.T_board[:3, :3] @ predicted.Y[:3, :3].T)
    inverse_information = np.linalg.inv(seen.information[:6, :6])
    corner_covariance = inverse_information * seen.pixel_px**2
    robot_covariance = np.diag([predicted.robot_sigma_rad**2] * 3 + [predicted.robot_sigma_m**2] * 3)
    J_camera = _motion_jacobian(seen.T_camera, middle)
    J_robot = _motion_jacobian(seen.T_flange, middle)
    J_board = -_motion_jacobian(predicted.Y, predicted_middle)
    # An error of the lens or of the board scale changes the board pose that fits the image.
    J_corrections = -J_camera @ inverse_information @ seen.information[:6, 6:]
    return BoardObservation(
        deviation=np.concatenate([rotation, middle - predicted_middle]),
        J_prediction=np.concatenate([J_camera, J_board, J_corrections], axis=1)[:, : len(predicted.covariance)],
        own_covariance=J_camera @ corner_covariance @ J_camera.T + J_robot @ robot_covariance @ J_robot.T,
    )


def _motion_jacobian(T: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Jacobian (6, 6) of the motion at `point` (3,) with respect to a small motion in the frame `T` (4, 4).

    A motion has the order rotation (rad), then translation (m).
    """
    T_point = T.copy()
    T_point[:3, 3] -= point
    return adjoint(T_point)


def check_same_setup(hand_eye: HandEye | HandEyeResult, views: Observations) -> None:
    """Check that the views have the camera, robot, board and mounting of the calibration.

    For a solved calibration, only the mounting is compared. For a calibration from a file, unknown properties are not
    compared, and the mounting is taken as eye-in-hand.

    Args:
        hand_eye: The calibration.
        views: The views for the verification.

    Raises:
        HandEyeMismatchError: A property differs. The message names the property in the calibration and in the views.
    """
    mounting = "eye-in-hand"
    if isinstance(hand_eye, HandEyeResult):
        mounting = hand_eye.mounting
    else:
        require_match(hand_eye, views.camera_id, views.robot_serial)
        if hand_eye.board is not None and hand_eye.board != views.board:
            raise HandEyeMismatchError(
                f"the calibration was made with the board {_describe(hand_eye.board)}, these views show the board "
                f"{_describe(views.board)}: verify with the board of the calibration, or calibrate again"
            )
    if mounting != views.mounting:
        raise HandEyeMismatchError(
            f"the calibration is {mounting}, these views are {views.mounting}: verify with views of the same mounting"
        )


def _describe(board: Board) -> str:
    return ", ".join(f"{key} {value}" for key, value in board.to_json().items() if value is not None)


def _rotation_vector(R: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_rotvec()
