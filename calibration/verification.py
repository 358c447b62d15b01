"""Whether a calibration holds for views that it was not solved from: does the board appear where it lay?

It may appear elsewhere because it was moved, or because the camera was. Seen from two sides, a board that was moved
appears in one place, and one seen by a camera that was moved in two.
"""

import itertools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.assumed import Assumed
from calibration.board_pose import board_poses
from calibration.errors import HandEyeInvalidError, HandEyeMismatchError
from calibration.hand_eye_result import HandEyeResult
from calibration.observations import Observations
from calibration.pose_stack import cross_matrix
from calibration.reprojection import LENS, corners_of, pixel_blocks
from calibration.storage import HandEye
from calibration.transforms import inverse

NOTABLE_M = 0.001
"""What is less off is good enough, however exact arm and camera are ..."""
NOTABLE_RAD = np.radians(0.2)
"""... and what is turned by less: 1 mm in 0.3 m."""
CHI2_LIMIT = 16.27
"""Of three numbers: 99.9 % of what chance brings about is less."""
SLIDING_LIMIT = 3.0
"""Standard deviations along the board's normal, along which a board on a table is not moved."""
UNCLEAR = 0.5
"""Views that put the board farther apart than this share of what it appears to be moved by do not agree on that. From
opposite sides, a camera that was moved along the table puts it apart by more than that by far."""
SAME_CAMERA = 0.05
"""Focal lengths of one camera differ by no larger share, unless its images have another size."""


@dataclass(frozen=True)
class VerifiedView:
    """Where one view puts the board."""

    name: str
    off_m: float
    """How far its middle appears from where it lay."""
    off_rad: float
    """By how much it appears turned."""
    expected_m: float
    """Root mean square of `off_m` by the calibration's covariance and the robot's and corners' noise."""


@dataclass(frozen=True)
class Verification:
    """How a calibration did."""

    views: tuple[VerifiedView, ...]
    """Those in which the board was seen."""
    worst_m: float
    """Largest `off_m`; NaN without views."""
    expected_m: float
    """Largest `expected_m`; NaN without views."""
    board_moved_m: float | None
    """The views agree that the board was moved so far; None where it was not, or where they do not agree."""
    passed: bool
    """Nothing contradicts where the camera is said to be. A board that was moved does not."""
    words: str
    """For a person at the cell."""

    def to_json(self) -> dict[str, Any]:
        """As JSON's values; null without views."""
        return {
            "passed": self.passed,
            "words": self.words,
            "worst_m": _finite(self.worst_m),
            "expected_m": _finite(self.expected_m),
            "board_moved_m": self.board_moved_m,
            "views": [vars(view) for view in self.views],
        }


@dataclass(frozen=True, eq=False)
class _Claim:
    """What a calibration says."""

    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    covariance: NDArray[np.float64]
    K: NDArray[np.float64]
    board_scale: float
    robot_sigma_m: float
    robot_sigma_rad: float


@dataclass(frozen=True, eq=False)
class _Seen:
    """One view's board, as far as the calibration puts it from where it lay: a rotation vector and a shift of its
    middle, along the axes in which the claim has the board (those of the base, for a camera on the flange)."""

    off: NDArray[np.float64]
    """(6,)."""
    by_claim: NDArray[np.float64]
    """(6, 6): how an error of X, as in its covariance, changes that."""
    own: NDArray[np.float64]
    """(6, 6) covariance of what is this view's alone: robot and corners."""


def verify(hand_eye: HandEye | HandEyeResult, views: Observations) -> Verification:
    """Where the views put the board by a calibration, and whether that is where it lay when it was solved.

    The views must not be those that it was solved from, and be two or more from different sides, to tell a camera that
    was moved from a board that was. `views` without any, or a calibration without a solution, pass nothing.

    Raises:
        HandEyeInvalidError: the calibration does not tell where the board lay and how sure it is.
        HandEyeMismatchError: it is of images of another size.
    """
    claim = _claim(hand_eye)
    if not views.views or not np.isfinite(claim.X).all():
        return _nothing("there is no view of the board that the calibration was not solved from")
    names, seen = _seen(claim, views)
    if not seen:
        return _nothing("the board could not be made out in the views that the calibration was not solved from")
    covariances = [each.own + each.by_claim @ claim.covariance @ each.by_claim.T for each in seen]
    rows = tuple(
        VerifiedView(
            name,
            float(np.linalg.norm(each.off[3:])),
            float(np.linalg.norm(each.off[:3])),
            float(np.sqrt(np.trace(covariance[3:, 3:]))),
        )
        for name, each, covariance in zip(names, seen, covariances, strict=True)
    )
    worst, expected = max(row.off_m for row in rows), max(row.expected_m for row in rows)
    off = any(_beyond(each.off, covariance) for each, covariance in zip(seen, covariances, strict=True))
    verification = Verification(rows, worst, expected, None, not off, "")
    if not off:
        words = (
            f"the board appears where it lay, {_mm(worst)} off at most, where up to about {_mm(2 * expected)} is chance"
        )
        return replace(verification, words=words)
    return _judged(verification, seen, covariances, claim)


def _judged(
    verification: Verification, seen: list[_Seen], covariances: list[NDArray[np.float64]], claim: _Claim
) -> Verification:
    """The board does not appear where it lay: why?"""
    if len(seen) < 2:
        words = (
            f"the board appears {_mm(verification.worst_m)} from where it lay: look from another side too, to tell "
            "whether it was moved or the camera"
        )
        return replace(verification, words=words)
    apart, disagree = 0.0, False
    for one, other in itertools.combinations(seen, 2):
        difference, by_claim = one.off - other.off, one.by_claim - other.by_claim
        apart = max(apart, float(np.linalg.norm(difference[3:])))
        disagree |= _beyond(difference, one.own + other.own + by_claim @ claim.covariance @ by_claim.T)
    anew = "check that camera and bracket are tight and that the tool is the same, then calibrate anew"
    if disagree:
        words = f"views from different sides put the board {_mm(apart)} apart, more than chance does: {anew}"
        return replace(verification, words=words)
    shift = np.mean([each.off for each in seen], axis=0)[3:]
    normal = claim.Y[:3, 2]
    rise, sigma = abs(float(shift @ normal)), max(float(np.sqrt(normal @ c[3:, 3:] @ normal)) for c in covariances)
    if rise > max(NOTABLE_M, SLIDING_LIMIT * sigma):
        words = (
            f"the board appears {_mm(rise)} above or below where it lay: unless something was laid under it, the "
            f"camera was moved along its view; {anew}"
        )
        return replace(verification, words=words)
    moved = float(np.linalg.norm(shift))
    if apart > UNCLEAR * moved:
        words = (
            f"the board appears {_mm(verification.worst_m)} from where it lay, and by such a little it cannot be told "
            f"whether it was moved or the camera: {anew}"
        )
        return replace(verification, words=words)
    words = (
        f"the board was moved by {_mm(moved)} since the calibration. The views agree on where it is now, so nothing "
        "speaks against the calibration"
    )
    return replace(verification, board_moved_m=moved, passed=True, words=words)


def _claim(hand_eye: HandEye | HandEyeResult) -> _Claim:
    if isinstance(hand_eye, HandEyeResult):
        return _Claim(
            hand_eye.X,
            hand_eye.Y,
            hand_eye.covariance,
            hand_eye.K,
            hand_eye.board_scale,
            hand_eye.robot_sigma_m,
            hand_eye.robot_sigma_rad,
        )
    told = (hand_eye.T_base_board, hand_eye.covariance, hand_eye.K)
    Y, covariance, K = told
    if Y is None or covariance is None or K is None:
        raise HandEyeInvalidError(
            "the calibration does not tell where the board lay, how sure it is and with which camera matrix, so that "
            "it cannot be verified: calibrate anew"
        )
    assumed = Assumed()
    return _Claim(
        hand_eye.T_flange_camera,
        Y,
        covariance,
        K,
        1.0 if hand_eye.board_scale is None else hand_eye.board_scale,
        assumed.robot_m if hand_eye.robot_sigma_m is None else hand_eye.robot_sigma_m,
        assumed.robot_rad if hand_eye.robot_sigma_rad is None else hand_eye.robot_sigma_rad,
    )


def _seen(claim: _Claim, views: Observations) -> tuple[list[str], list[_Seen]]:
    """Names and boards of the views in which there is one."""
    if np.abs(claim.K[[0, 1], [0, 1]] / views.K[[0, 1], [0, 1]] - 1).max() > SAME_CAMERA:
        raise HandEyeMismatchError(
            f"the calibration is of images with a focal length of {claim.K[0, 0]:.0f} px, these have "
            f"{views.K[0, 0]:.0f} px: give the camera the resolution that it was calibrated with, or calibrate anew"
        )
    # The corners are undistorted by what the camera tells; the fitted matrix takes it from there.
    told = corners_of(views)
    corners = replace(told, K=claim.K, points=claim.board_scale * told.points)
    poses = board_poses(corners)
    information = pixel_blocks(poses.T_camera_board, np.zeros(LENS), corners, poses.good).information
    names, seen = [], []
    for k in np.flatnonzero(poses.found):
        view, T_camera_board = views.views[k], poses.T_camera_board[k]
        A = view.T_base_flange if views.mounting == "eye-in-hand" else inverse(view.T_base_flange)
        T_camera = A @ claim.X
        board = T_camera @ T_camera_board
        middle = board[:3, :3] @ corners.middle + board[:3, 3]
        lay = claim.Y[:3, :3] @ corners.middle + claim.Y[:3, 3]
        off = np.concatenate([_rotation_vector(board[:3, :3] @ claim.Y[:3, :3].T), middle - lay])
        by_claim = _at(T_camera, middle)
        pixel_px = max(float(poses.rms_px[k]), 1e-3)
        of_corners = np.linalg.inv(information[k, :6, :6]) * pixel_px**2
        by_robot = _at(view.T_base_flange if views.mounting == "eye-in-hand" else np.eye(4), middle)
        of_robot = np.diag([claim.robot_sigma_rad**2] * 3 + [claim.robot_sigma_m**2] * 3)
        own = by_claim @ of_corners @ by_claim.T + by_robot @ of_robot @ by_robot.T
        names.append(view.name)
        seen.append(_Seen(off, by_claim, own))
    return names, seen


def _at(T: NDArray[np.float64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6, 6): what a small motion in the frame `T` (4, 4) does at a place (3,), both seen from outside that frame."""
    R = T[:3, :3]
    result = np.zeros((6, 6))
    result[:3, :3] = result[3:, 3:] = R
    result[3:, :3] = -cross_matrix(place - T[:3, 3]) @ R
    return result


def _beyond(off: NDArray[np.float64], covariance: NDArray[np.float64]) -> bool:
    """Whether a difference (6,) is notable and not chance."""

    def unlikely(part: slice) -> bool:
        return float(off[part] @ np.linalg.solve(covariance[part, part], off[part])) > CHI2_LIMIT

    turned, shifted = slice(0, 3), slice(3, 6)
    notable = ((shifted, NOTABLE_M), (turned, NOTABLE_RAD))
    return any(float(np.linalg.norm(off[part])) > least and unlikely(part) for part, least in notable)


def _nothing(words: str) -> Verification:
    return Verification((), math.nan, math.nan, None, False, words)


def _rotation_vector(R: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_rotvec()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"
