"""Verification of a calibration with new views of the board.

The board should appear at its pose during the calibration. A different pose means that the board or the camera was
moved. Views from two sides distinguish the two cases. A moved board appears at one position on the table. A moved
camera makes the board appear at two positions, or above or below the table.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import rotation_angles
from calibration.input_checks.observations import check_each_view
from calibration.observations import Observations
from calibration.result import Finding, HandEyeResult
from calibration.storage.document import VerificationResource
from calibration.storage.hand_eye_file import HandEye
from calibration.verification.board_prediction import (
    BoardObservation,
    PredictedBoard,
    check_same_setup,
    observe_board,
    predict_board,
)
from calibration.verification.displacement import Displacement, estimate_displacement

NOTABLE_M = 0.001
"""Maximum deviation that always passes, metres, even if the noise is smaller."""
NOTABLE_RAD = np.radians(0.2)
"""Maximum rotation that always passes, radians. It is 1 mm at 0.3 m."""
FALSE_ALARM_RATE = 0.001
"""Fraction of verifications in which noise alone fails one of the tests."""
MIN_LOG_RATIO = 6.0
"""Minimum `Displacement.board_log_ratio` for a moved board. It corresponds to a likelihood ratio of 20."""
SIDES_RAD = np.radians(20.0)
"""Minimum rotation of the camera between two views that count as two sides, radians. At this angle, a camera that was
moved by 3 mm shows the board at positions 1 mm apart."""


@dataclass(frozen=True)
class VerificationView:
    """Deviation of the board in one view from its pose during the calibration."""

    name: str
    """Name of the view."""
    deviation_m: float
    """Distance of the middle of the board from its position during the calibration, metres."""
    deviation_rad: float
    """Rotation of the board from its orientation during the calibration, radians."""
    expected_m: float
    """Expected root mean square of `deviation_m`, from the covariance of the calibration and from the noise, metres."""
    expected_rad: float
    """Expected root mean square of `deviation_rad`, radians."""


@dataclass(frozen=True)
class Verification:
    """Result of a verification."""

    views: tuple[VerificationView, ...]
    """Deviations in the views with a board pose."""
    max_deviation_m: float
    """Largest `deviation_m`; NaN without views."""
    expected_m: float
    """Largest `expected_m`; NaN without views."""
    max_deviation_rad: float
    """Largest `deviation_rad`; NaN without views."""
    expected_rad: float
    """Largest `expected_rad`; NaN without views."""
    board_displacement_m: float | None
    """Distance by which the board was moved, metres; None if the views do not show that the board was moved."""
    board_rotation_rad: float | None
    """Rotation of the board about its normal, radians; None if `board_displacement_m` is None."""
    passed: bool
    """Whether the calibration still holds. A moved board does not contradict the calibration."""
    message: str
    """Result and advice for the operator."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON values. NaN becomes null."""
        return VerificationResource.model_validate(self).model_dump(mode="json")


def verify(hand_eye: HandEye | HandEyeResult, views: Observations) -> Verification:
    """Check with new views whether the board appears at its pose during the calibration.

    Args:
        hand_eye: The calibration.
        views: Two or more views of the board, from different sides. They must not have been used for the calibration.
            One view does not distinguish a moved camera from a moved board. Without views, the verification fails.

    Raises:
        HandEyeInvalidError: The calibration has no board pose, no covariance or no camera matrix.
        HandEyeMismatchError: The views have another camera, robot, board, mounting or image size than the calibration.
        HandEyeInputError: A view is not valid.
    """
    predicted = predict_board(hand_eye)
    check_same_setup(hand_eye, views)
    if not views.views:
        return _not_verified("there is no view of the board besides those that the calibration was solved from")
    check_each_view(views)
    if not all(np.isfinite(value).all() for value in (predicted.X, predicted.Y, predicted.covariance, predicted.K)):
        return _not_verified("the calibration has no solution")
    names, observations = observe_board(predicted, views)
    if not observations:
        return _not_verified("the board was not found in any view besides those that the calibration was solved from")
    covariances = [
        each.own_covariance + each.J_prediction @ predicted.covariance @ each.J_prediction.T for each in observations
    ]
    rows = tuple(map(_describe_view, names, observations, covariances))
    displacement = estimate_displacement(predicted, observations)
    displaced = _is_displaced(observations, covariances, displacement, predicted)
    max_deviation_m = max(row.deviation_m for row in rows)
    expected_m = max(row.expected_m for row in rows)
    by_noise_m = np.sqrt(_chi2_limit(3, predicted, 2 * len(rows) + 1) / 3) * expected_m
    verification = Verification(
        views=rows,
        max_deviation_m=max_deviation_m,
        expected_m=expected_m,
        max_deviation_rad=max(row.deviation_rad for row in rows),
        expected_rad=max(row.expected_rad for row in rows),
        board_displacement_m=None,
        board_rotation_rad=None,
        passed=not displaced,
        message=f"the board appears where it lay, at most {_mm(max_deviation_m)} off; noise explains up to about "
        f"{_mm(by_noise_m)}",
    )
    if displaced:
        return _explain(verification, observations, displacement, predicted)
    return verification


def _describe_view(name: str, observation: BoardObservation, covariance: NDArray[np.float64]) -> VerificationView:
    """Return the deviation in one view. `covariance` (6, 6) belongs to the deviation."""
    return VerificationView(
        name=name,
        deviation_m=float(np.linalg.norm(observation.deviation[3:])),
        deviation_rad=float(np.linalg.norm(observation.deviation[:3])),
        expected_m=float(np.sqrt(np.trace(covariance[3:, 3:]))),
        expected_rad=float(np.sqrt(np.trace(covariance[:3, :3]))),
    )


def verification_findings(verification: Verification) -> tuple[Finding, ...]:
    """Return the findings against a new calibration from its held-out views.

    The board stands still while the views are taken. A board that appears moved therefore contradicts the calibration.

    Args:
        verification: Result of `verify` with the held-out views.

    Returns:
        The findings; empty if the calibration holds.
    """
    if not verification.views:
        message = f"{verification.message}, so the calibration is not verified: run a verification, or calibrate again"
        return (Finding("not-verified", message, False),)
    if verification.passed and verification.board_displacement_m is None:
        return ()
    deviation = format_discrepancy(verification.max_deviation_m, verification.max_deviation_rad)
    expected = format_discrepancy(verification.expected_m, verification.expected_rad)
    message = (
        f"in the views that were held out, the board appears {deviation} off, and about {expected} is expected: check "
        "that board, camera and bracket are firm, and calibrate again"
    )
    return (Finding("verification-failed", message, True),)


def _is_displaced(
    observations: list[BoardObservation],
    covariances: list[NDArray[np.float64]],
    displacement: Displacement,
    predicted: PredictedBoard,
) -> bool:
    """Return whether the board appears significantly displaced from its predicted pose.

    Each view is tested alone. One more test assumes that the camera moved and uses all views together. It detects
    smaller displacements. `covariances` (6, 6) belong to the deviations of the views.
    """
    tests = 2 * len(observations) + 1
    limit = _chi2_limit(3, predicted, tests)
    if any(_is_significant(each.deviation, C, limit) for each, C in zip(observations, covariances, strict=True)):
        return True
    turn_rad = float(np.linalg.norm(displacement.camera_deviations[:, :3], axis=1).max())
    shift_m = float(np.linalg.norm(displacement.camera_deviations[:, 3:], axis=1).max())
    return (shift_m > NOTABLE_M or turn_rad > NOTABLE_RAD) and displacement.camera_chi2 > _chi2_limit(
        6, predicted, tests
    )


def _explain(
    verification: Verification,
    observations: list[BoardObservation],
    displacement: Displacement,
    predicted: PredictedBoard,
) -> Verification:
    """Return `verification` with the cause of the displacement: moved board, moved camera, or not distinguishable."""
    limit = _chi2_limit(3, predicted, 2 * max(len(displacement.pair_differences), 1))
    pairs = zip(displacement.pair_differences, displacement.pair_covariances, strict=True)
    recalibrate = "check that camera and bracket are tight and that the tool is the same, then calibrate again"
    if any(_is_significant(difference, covariance, limit) for difference, covariance in pairs):
        max_turn_rad = np.linalg.norm(displacement.pair_differences[:, :3], axis=1).max()
        max_shift_m = np.linalg.norm(displacement.pair_differences[:, 3:], axis=1).max()
        apart = format_discrepancy(max_shift_m, max_turn_rad)
        message = f"views from different sides show the board at poses {apart} apart, more than noise: {recalibrate}"
        return replace(verification, message=message)
    deviation = format_discrepancy(verification.max_deviation_m, verification.max_deviation_rad)
    appears = f"the board appears {deviation} from where it lay"
    if not _from_two_sides(observations):
        message = (
            f"{appears}: take views from two sides, at least {np.degrees(SIDES_RAD):.0f} degrees apart, to tell "
            "whether the board or the camera was moved"
        )
        return replace(verification, message=message)
    off_plane = _off_plane(displacement, predicted)
    if off_plane is not None:
        message = (
            f"the board appears {off_plane}: unless something was put under the board, the camera was moved; "
            f"{recalibrate}"
        )
        return replace(verification, message=message)
    if not displacement.board_log_ratio >= MIN_LOG_RATIO:
        message = f"{appears}, too little to tell whether the board or the camera was moved: {recalibrate}"
        return replace(verification, message=message)
    moved_m = float(np.linalg.norm(displacement.mean[3:]))
    turned_rad = abs(float(displacement.mean[:3] @ predicted.Y[:3, 2]))
    motions = []
    if moved_m > NOTABLE_M or turned_rad <= NOTABLE_RAD:
        motions.append(f"moved by {_mm(moved_m)}")
    if turned_rad > NOTABLE_RAD:
        motions.append(f"turned by {_degrees(turned_rad)}")
    message = (
        f"the board was {' and '.join(motions)} since the calibration. All views agree on its new pose, so they "
        "confirm the calibration"
    )
    return replace(
        verification, board_displacement_m=moved_m, board_rotation_rad=turned_rad, passed=True, message=message
    )


def _off_plane(displacement: Displacement, predicted: PredictedBoard) -> str | None:
    """Return a description of how the board left its original plane, or None if the board is still in this plane."""
    along = predicted.Y[:3, :2]
    normal = predicted.Y[:3, 2:3]
    rise = displacement.mean[3:] @ normal
    tilt = displacement.mean[:3] @ along
    covariance = displacement.covariance
    if _exceeds(rise, normal.T @ covariance[3:, 3:] @ normal, NOTABLE_M, _chi2_limit(1, predicted, 2)):
        return f"{_mm(abs(float(rise[0])))} above or below where it lay"
    if _exceeds(tilt, along.T @ covariance[:3, :3] @ along, NOTABLE_RAD, _chi2_limit(2, predicted, 2)):
        return f"tilted by {_degrees(float(np.linalg.norm(tilt)))} against where it lay"
    return None


def _from_two_sides(observations: list[BoardObservation]) -> bool:
    """Return whether the camera rotations of any two views differ by at least `SIDES_RAD`."""
    rotations = np.array([each.J_prediction[:3, :3] for each in observations])
    return bool(rotation_angles(rotations[:, None].swapaxes(-1, -2) @ rotations).max() >= SIDES_RAD)


def _is_significant(deviation: NDArray[np.float64], covariance: NDArray[np.float64], limit: float) -> bool:
    """Return whether the translation or the rotation of a deviation (6,) is large and significant (see `_exceeds`)."""
    return _exceeds(deviation[3:], covariance[3:, 3:], NOTABLE_M, limit) or _exceeds(
        deviation[:3], covariance[:3, :3], NOTABLE_RAD, limit
    )


def _exceeds(values: NDArray[np.float64], covariance: NDArray[np.float64], notable: float, limit: float) -> bool:
    """Return whether `values` (D,) are longer than `notable`, and their squared Mahalanobis length exceeds `limit`."""
    chi2 = float(values @ np.linalg.solve(covariance, values))
    return not float(np.linalg.norm(values)) <= notable and not chi2 <= limit


def _chi2_limit(dimensions: int, predicted: PredictedBoard, tests: int) -> float:
    """Return the chi-square limit of one test, so that all `tests` together have the rate `FALSE_ALARM_RATE`.

    `dimensions` is the number of tested values, for example 3 for a translation.
    """
    from scipy.special import fdtri

    # The noise levels are estimated from few errors, three per view, so Snedecor's F distribution applies.
    degrees_of_freedom = 3.0 * max(predicted.views_used - 3, 1)
    return dimensions * float(fdtri(dimensions, degrees_of_freedom, 1 - FALSE_ALARM_RATE / tests))


def _not_verified(message: str) -> Verification:
    """Return a failed verification with no views and the given message."""
    return Verification(
        views=(),
        max_deviation_m=math.nan,
        expected_m=math.nan,
        max_deviation_rad=math.nan,
        expected_rad=math.nan,
        board_displacement_m=None,
        board_rotation_rad=None,
        passed=False,
        message=message,
    )


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):.2f} degrees"


def format_discrepancy(metres: float, radians: float) -> str:
    """Format the difference of two poses for the operator, in millimetres and degrees."""
    return f"{_mm(metres)} and {_degrees(radians)}"
