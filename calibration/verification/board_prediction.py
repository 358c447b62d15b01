"""Where views put the board by a calibration, against where it lay when that was solved, and what chance adds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.errors import HandEyeInvalidError, HandEyeMismatchError
from calibration.geometry.se3 import cross_matrix, invert_poses
from calibration.input_checks.observations import FEWEST_VIEWS
from calibration.observations import Observations
from calibration.pose_estimation.board_pose import estimate_board_poses
from calibration.pose_estimation.corner_disambiguation import number_nearest_prediction
from calibration.pose_estimation.projection import LENS, pixel_blocks, stack_corners
from calibration.result import HandEyeResult
from calibration.solver.noise import NoisePriors
from calibration.storage.hand_eye_file import HandEye, require_match
from calibration.target.board import Board

SAME_CAMERA = 0.05
"""Focal lengths of one camera differ by no larger share, unless its images have another size."""


@dataclass(frozen=True, eq=False)
class PredictedBoard:
    """What a calibration says."""

    X: NDArray[np.float64]
    """(4, 4) `T_flange_camera`; `T_base_camera` where the camera stands in the cell (eye-to-hand)."""
    Y: NDArray[np.float64]
    """(4, 4) where the board lay: `T_base_board`, or `T_flange_board`."""
    covariance: NDArray[np.float64]
    """(C, C) of X (C = 6), or also of Y (12) and the lens and the board's scale (17), as
    `HandEyeResult.joint_covariance`."""
    K: NDArray[np.float64]
    """(3, 3) as fitted, pixels."""
    board_scale: float
    """The board's true size as a share of the told one."""
    robot_sigma_m: float
    """Noise of the robot's poses along one axis."""
    robot_sigma_rad: float
    """The same about one axis."""
    views_used: int
    """It was solved from so many, and its noise estimated from them."""


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """One view's board, as far as the calibration puts it from where it lay: a rotation vector and a shift of its
    middle, along the axes in which the claim has the board (those of the base, for a camera on the flange)."""

    off: NDArray[np.float64]
    """(6,)."""
    by_claim: NDArray[np.float64]
    """(6, C): how an error of the claim, as in its covariance, changes that; the first six are X's."""
    own: NDArray[np.float64]
    """(6, 6) covariance of what is this view's alone: robot and corners."""


def predict_board(hand_eye: HandEye | HandEyeResult) -> PredictedBoard:
    """What it says of where the board is to be seen.

    Raises:
        HandEyeInvalidError: it does not tell where the board lay and how sure it is.
    """
    if isinstance(hand_eye, HandEyeResult):
        return PredictedBoard(
            hand_eye.X,
            hand_eye.Y,
            _joint(hand_eye, hand_eye.covariance),
            hand_eye.K,
            hand_eye.board_scale,
            hand_eye.robot_sigma_m,
            hand_eye.robot_sigma_rad,
            sum(view.used for view in hand_eye.views),
        )
    told = (hand_eye.T_base_board, hand_eye.covariance, hand_eye.K)
    Y, covariance, K = told
    if Y is None or covariance is None or K is None:
        raise HandEyeInvalidError(
            "the calibration does not tell where the board lay, how sure it is and with which camera matrix, so that "
            "it cannot be verified: calibrate anew"
        )
    assumed = NoisePriors()
    return PredictedBoard(
        hand_eye.T_flange_camera,
        Y,
        _joint(hand_eye, covariance),
        K,
        1.0 if hand_eye.board_scale is None else hand_eye.board_scale,
        assumed.robot_m if hand_eye.robot_sigma_m is None else hand_eye.robot_sigma_m,
        assumed.robot_rad if hand_eye.robot_sigma_rad is None else hand_eye.robot_sigma_rad,
        FEWEST_VIEWS if hand_eye.views_used is None else hand_eye.views_used,
    )


def _joint(hand_eye: HandEye | HandEyeResult, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """With Y and the rest where it is known: what an unverified board size adds to X does not show in its views."""
    return covariance if hand_eye.joint_covariance is None else hand_eye.joint_covariance


def observe_board(claim: PredictedBoard, views: Observations) -> tuple[list[str], list[BoardObservation]]:
    """Names and boards of the views in which there is one; numbered so that it is turned least from how it lay.

    Raises:
        HandEyeMismatchError: images of another size.
    """
    if np.abs(claim.K[[0, 1], [0, 1]] / views.K[[0, 1], [0, 1]] - 1).max() > SAME_CAMERA:
        raise HandEyeMismatchError(
            f"the calibration is of images with a focal length of {claim.K[0, 0]:.0f} px, these have "
            f"{views.K[0, 0]:.0f} px: give the camera the resolution that it was calibrated with, or calibrate anew"
        )
    flange = np.array([view.T_base_flange for view in views.views])
    T_camera = (flange if views.mounting == "eye-in-hand" else invert_poses(flange)) @ claim.X
    views = number_nearest_prediction(views, invert_poses(T_camera) @ claim.Y)
    # The corners are undistorted by what the camera tells; the fitted matrix takes it from there.
    told = stack_corners(views)
    corners = replace(told, K=claim.K, points=claim.board_scale * told.points)
    poses = estimate_board_poses(corners)
    information = pixel_blocks(poses.T_camera_board, np.zeros(LENS), corners, poses.good).information
    names, seen = [], []
    for k in np.flatnonzero(poses.found):
        board = T_camera[k] @ poses.T_camera_board[k]
        middle = board[:3, :3] @ corners.middle + board[:3, 3]
        lay = claim.Y[:3, :3] @ corners.middle + claim.Y[:3, 3]
        off = np.concatenate([_rotation_vector(board[:3, :3] @ claim.Y[:3, :3].T), middle - lay])
        by_camera = _at(T_camera[k], middle)
        of_pose = np.linalg.inv(information[k, :6, :6])
        # A wrong lens or size is made up for by another pose in the picture.
        by_lens = -by_camera @ of_pose @ information[k, :6, 6:]
        by_claim = np.concatenate([by_camera, -_at(claim.Y, lay), by_lens], axis=1)[:, : len(claim.covariance)]
        pixel_px = max(float(poses.rms_px[k]), 1e-3)
        of_corners = of_pose * pixel_px**2
        by_robot = _at(flange[k] if views.mounting == "eye-in-hand" else np.eye(4), middle)
        of_robot = np.diag([claim.robot_sigma_rad**2] * 3 + [claim.robot_sigma_m**2] * 3)
        own = by_camera @ of_corners @ by_camera.T + by_robot @ of_robot @ by_robot.T
        names.append(views.views[k].name)
        seen.append(BoardObservation(off, by_claim, own))
    return names, seen


def _at(T: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6, 6): what a small motion in the frame `T` (4, 4) does at a place (3,), both seen from outside that frame."""
    R = T[:3, :3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = R
    result[3:, :3] = -cross_matrix(place - T[:3, 3]) @ R
    return result


def check_same(hand_eye: HandEye | HandEyeResult, views: Observations) -> None:
    """Refuses views of something else than the calibration is of, as far as it tells. Raises HandEyeMismatchError."""
    mounting = "eye-in-hand"
    if isinstance(hand_eye, HandEyeResult):
        mounting = hand_eye.mounting
    else:
        require_match(hand_eye, views.camera_id, views.robot_serial)
        if hand_eye.board is not None and hand_eye.board != views.board:
            raise HandEyeMismatchError(
                f"the calibration was made with the board {_named(hand_eye.board)}, these views are of the board "
                f"{_named(views.board)}: verify with the board of the calibration, or calibrate anew"
            )
    if mounting != views.mounting:
        raise HandEyeMismatchError(
            f"the calibration is {mounting}, these views are {views.mounting}: verify with views of the same mounting"
        )


def _named(board: Board) -> str:
    return ", ".join(f"{key} {value}" for key, value in board.to_json().items() if value is not None)


def _rotation_vector(R: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_rotvec()
