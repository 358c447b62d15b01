"""Whether a calibration holds for views that it was not solved from: does the board appear where it lay?

It may appear elsewhere because it was moved, or because the camera was. Seen from two sides, a board that was moved
appears in one place on the table, and one seen by a camera that was moved in two, or off the table.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import rotation_angles
from calibration.input_checks.observations import check_each
from calibration.observations import Observations
from calibration.result import HandEyeResult
from calibration.storage.hand_eye_file import HandEye
from calibration.verification.board_prediction import (
    BoardObservation,
    PredictedBoard,
    check_same,
    observe_board,
    predict_board,
)
from calibration.verification.displacement import Displacement, locate_displacement

NOTABLE_M = 0.001
"""What is less off is good enough, however exact arm and camera are ..."""
NOTABLE_RAD = np.radians(0.2)
"""... and what is turned by less: 1 mm in 0.3 m."""
CHANCE = 0.001
"""So often chance is taken for something else, all that is looked at together."""
LIKELIER = 6.0
"""Where twice the logarithm of by how much likelier it is that the board was moved than that the camera was is less, it
cannot be told: 20 times likelier."""
SIDES_RAD = np.radians(20.0)
"""Cameras that look from directions this far apart look from two sides: one that was moved by 3 mm puts the board
1 mm apart, which is notable."""


@dataclass(frozen=True)
class VerifiedView:
    """Where one view sees the board, by the calibration."""

    name: str
    """Name of the view."""
    off_m: float
    """Distance of the middle of the board from where it lay, metres."""
    off_rad: float
    """Rotation of the board against where it lay, radians."""
    expected_m: float
    """Expected root mean square of `off_m`, from the covariance of the calibration and the noise, metres."""
    expected_rad: float
    """Expected root mean square of `off_rad`, radians."""


@dataclass(frozen=True)
class Verification:
    """Result of a verification."""

    views: tuple[VerifiedView, ...]
    """The views in which the board was seen."""
    worst_m: float
    """Largest `off_m`; NaN without views."""
    expected_m: float
    """Largest `expected_m`; NaN without views."""
    worst_rad: float
    """Largest `off_rad`; NaN without views."""
    expected_rad: float
    """Largest `expected_rad`; NaN without views."""
    board_moved_m: float | None
    """Distance by which the board moved, metres, if the views agree that it did; otherwise None."""
    board_turned_rad: float | None
    """Rotation of the board about its normal, radians; None if `board_moved_m` is None."""
    passed: bool
    """Whether the calibration still holds. A board that was moved does not contradict it."""
    words: str
    """Message for people."""

    def to_json(self) -> dict[str, Any]:
        """Return the result as JSON values. Values that need views are null without them."""
        return {
            "passed": self.passed,
            "words": self.words,
            "worst_m": _finite(self.worst_m),
            "expected_m": _finite(self.expected_m),
            "worst_rad": _finite(self.worst_rad),
            "expected_rad": _finite(self.expected_rad),
            "board_moved_m": self.board_moved_m,
            "board_turned_rad": self.board_turned_rad,
            "views": [vars(view) for view in self.views],
        }


def verify(hand_eye: HandEye | HandEyeResult, views: Observations) -> Verification:
    """Check with views that a calibration was not solved from whether the board appears where it lay.

    Args:
        hand_eye: The calibration.
        views: Two or more views of the board, from different sides. One view cannot tell a moved camera from a moved
            board. Without views, nothing passes.

    Raises:
        HandEyeInvalidError: The calibration has no board pose or no covariance.
        HandEyeMismatchError: It is of another camera, robot, board, mounting or image size.
        HandEyeInputError: A view is not valid.
    """
    claim = predict_board(hand_eye)
    check_same(hand_eye, views)
    if not views.views:
        return _nothing("there is no view of the board that the calibration was not solved from")
    check_each(views)
    if not all(np.isfinite(told).all() for told in (claim.X, claim.Y, claim.covariance, claim.K)):
        return _nothing("the calibration has no solution")
    names, seen = observe_board(claim, views)
    if not seen:
        return _nothing("the board could not be made out in the views that the calibration was not solved from")
    covariances = [each.own + each.by_claim @ claim.covariance @ each.by_claim.T for each in seen]
    rows = tuple(
        VerifiedView(
            name,
            float(np.linalg.norm(each.off[3:])),
            float(np.linalg.norm(each.off[:3])),
            float(np.sqrt(np.trace(covariance[3:, 3:]))),
            float(np.sqrt(np.trace(covariance[:3, :3]))),
        )
        for name, each, covariance in zip(names, seen, covariances, strict=True)
    )
    place = locate_displacement(claim, seen)
    off = _is_elsewhere(seen, covariances, place, claim)
    expected = max(row.expected_m for row in rows)
    verification = Verification(
        views=rows,
        worst_m=max(row.off_m for row in rows),
        expected_m=expected,
        worst_rad=max(row.off_rad for row in rows),
        expected_rad=max(row.expected_rad for row in rows),
        board_moved_m=None,
        board_turned_rad=None,
        passed=not off,
        words=f"the board appears where it lay, {_mm(max(row.off_m for row in rows))} off at most, where up to about "
        f"{_mm(np.sqrt(_limit(3, claim, 2 * len(rows) + 1) / 3) * expected)} is chance",
    )
    return _judged(verification, seen, place, claim) if off else verification


def _is_elsewhere(
    seen: list[BoardObservation], covariances: list[NDArray[np.float64]], place: Displacement, claim: PredictedBoard
) -> bool:
    """Whether the board is notably elsewhere, and not by chance: in a view by itself, or as far as a motion of the
    camera explains it in all of them together, which shows smaller ones."""
    tests = 2 * len(seen) + 1
    limit = _limit(3, claim, tests)
    if any(_is_off(each.off, covariance, limit) for each, covariance in zip(seen, covariances, strict=True)):
        return True
    shift, turn = (float(np.linalg.norm(place.by_camera[:, part], axis=1).max()) for part in (slice(3, 6), slice(3)))
    return (shift > NOTABLE_M or turn > NOTABLE_RAD) and place.camera_squares > _limit(6, claim, tests)


def _judged(
    verification: Verification, seen: list[BoardObservation], place: Displacement, claim: PredictedBoard
) -> Verification:
    """The board does not appear where it lay: why?"""
    limit = _limit(3, claim, 2 * max(len(place.apart), 1))
    anew = "check that camera and bracket are tight and that the tool is the same, then calibrate anew"
    if any(_is_off(*pair, limit) for pair in zip(place.apart, place.apart_covariances, strict=True)):
        turns, shifts = place.apart[:, :3], place.apart[:, 3:]
        apart = format_discrepancy(np.linalg.norm(shifts, axis=1).max(), np.linalg.norm(turns, axis=1).max())
        words = f"views from different sides put the board {apart} apart, more than chance does: {anew}"
        return replace(verification, words=words)
    appears = f"the board appears {format_discrepancy(verification.worst_m, verification.worst_rad)} from where it lay"
    if not _from_two_sides(seen):
        words = (
            f"{appears}: look from two sides, {np.degrees(SIDES_RAD):.0f} degrees apart or more, to tell whether it "
            "was moved or the camera"
        )
        return replace(verification, words=words)
    how = _off_the_table(place, claim)
    if how is not None:
        words = (
            f"the board appears {how} where it lay: unless something was laid under it, the camera was moved; {anew}"
        )
        return replace(verification, words=words)
    if not place.board_likelier >= LIKELIER:
        words = f"{appears}, and by such a little it cannot be told whether it was moved or the camera: {anew}"
        return replace(verification, words=words)
    moved, turned = float(np.linalg.norm(place.off[3:])), abs(float(place.off[:3] @ claim.Y[:3, 2]))
    told = [f"moved by {_mm(moved)}"] if moved > NOTABLE_M or turned <= NOTABLE_RAD else []
    told += [f"turned by {_degrees(turned)}"] if turned > NOTABLE_RAD else []
    words = (
        f"the board was {' and '.join(told)} since the calibration. The views agree on where it is now, so nothing "
        "speaks against the calibration"
    )
    return replace(verification, board_moved_m=moved, board_turned_rad=turned, passed=True, words=words)


def _off_the_table(place: Displacement, claim: PredictedBoard) -> str | None:
    """How a board is off the plane in which it lay, in words; None: it is not."""
    along, normal = claim.Y[:3, :2], claim.Y[:3, 2:3]
    rise, tilt = place.off[3:] @ normal, place.off[:3] @ along
    covariance = place.covariance
    if _beyond(rise, normal.T @ covariance[3:, 3:] @ normal, NOTABLE_M, _limit(1, claim, 2)):
        return f"{_mm(abs(float(rise[0])))} above or below"
    if _beyond(tilt, along.T @ covariance[:3, :3] @ along, NOTABLE_RAD, _limit(2, claim, 2)):
        return f"tilted by {_degrees(float(np.linalg.norm(tilt)))} against how"
    return None


def _from_two_sides(seen: list[BoardObservation]) -> bool:
    turns = np.array([each.by_claim[:3, :3] for each in seen])
    return bool(rotation_angles(turns[:, None].swapaxes(-1, -2) @ turns).max() >= SIDES_RAD)


def _is_off(off: NDArray[np.float64], covariance: NDArray[np.float64], limit: float) -> bool:
    """Whether a difference (6,) is notable and not chance, in turn or shift, whose squares chance keeps below
    `limit`."""
    return _beyond(off[3:], covariance[3:, 3:], NOTABLE_M, limit) or _beyond(
        off[:3], covariance[:3, :3], NOTABLE_RAD, limit
    )


def _beyond(off: NDArray[np.float64], covariance: NDArray[np.float64], least: float, limit: float) -> bool:
    """Whether numbers (D,) are more than the `least` that is notable, and in standard deviations than the `limit`."""
    squares = float(off @ np.linalg.solve(covariance, off))
    return not float(np.linalg.norm(off)) <= least and not squares <= limit


def _limit(numbers: int, claim: PredictedBoard, tests: int) -> float:
    """Squares in standard deviations below which chance keeps so many numbers in each of so many tests, but for a
    share `CHANCE` of verifications."""
    from scipy.special import fdtri

    # The noise of turns and that of shifts are each estimated from three errors of each of few views: Snedecor's
    # distribution, not the normal one.
    errors = 3.0 * max(claim.views_used - 3, 1)
    return numbers * float(fdtri(numbers, errors, 1 - CHANCE / tests))


def _nothing(words: str) -> Verification:
    return Verification((), math.nan, math.nan, math.nan, math.nan, None, None, False, words)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"


def _degrees(radians: float) -> str:
    return f"{math.degrees(radians):.2f} degrees"


def format_discrepancy(metres: float, radians: float) -> str:
    """How far two poses are apart, for people."""
    return f"{_mm(metres)} and {_degrees(radians)}"
