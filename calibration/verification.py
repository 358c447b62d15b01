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

from calibration.hand_eye_result import HandEyeResult
from calibration.input_check import check_each
from calibration.observations import Observations
from calibration.pose_stack import rotation_angles
from calibration.reappearance import Appearance, Claim, appearances, check_same, claim_of
from calibration.storage import HandEye

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
SIDES_RAD = np.radians(20.0)
"""Cameras that look from directions this far apart look from two sides: one that was moved by 3 mm puts the board
1 mm apart, which is notable."""


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


def verify(hand_eye: HandEye | HandEyeResult, views: Observations) -> Verification:
    """Where the views put the board by a calibration, and whether that is where it lay when it was solved.

    The views must not be those that it was solved from, and be two or more from different sides, to tell a camera that
    was moved from a board that was. `views` without any, or a calibration without a solution, pass nothing.

    Raises:
        HandEyeInvalidError: the calibration does not tell where the board lay and how sure it is.
        HandEyeMismatchError: it is of another camera, robot, board or mounting, or of images of another size.
        HandEyeInputError: views that cannot be, by `calibration.input_check.check_each`.
    """
    claim = claim_of(hand_eye)
    check_same(hand_eye, views)
    if not views.views:
        return _nothing("there is no view of the board that the calibration was not solved from")
    check_each(views)
    if not all(np.isfinite(told).all() for told in (claim.X, claim.Y, claim.covariance, claim.K)):
        return _nothing("the calibration has no solution")
    names, seen = appearances(claim, views)
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
    verification: Verification, seen: list[Appearance], covariances: list[NDArray[np.float64]], claim: Claim
) -> Verification:
    """The board does not appear where it lay: why?"""
    apart, disagree = 0.0, False
    for one, other in itertools.combinations(seen, 2):
        difference, by_claim = one.off - other.off, one.by_claim - other.by_claim
        apart = max(apart, float(np.linalg.norm(difference[3:])))
        disagree |= _beyond(difference, one.own + other.own + by_claim @ claim.covariance @ by_claim.T)
    anew = "check that camera and bracket are tight and that the tool is the same, then calibrate anew"
    if disagree:
        words = f"views from different sides put the board {_mm(apart)} apart, more than chance does: {anew}"
        return replace(verification, words=words)
    if not _from_two_sides(seen):
        words = (
            f"the board appears {_mm(verification.worst_m)} from where it lay: look from two sides, "
            f"{np.degrees(SIDES_RAD):.0f} degrees apart or more, to tell whether it was moved or the camera"
        )
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


def _from_two_sides(seen: list[Appearance]) -> bool:
    turns = np.array([each.by_claim[:3, :3] for each in seen])
    return bool(rotation_angles(turns[:, None].swapaxes(-1, -2) @ turns).max() >= SIDES_RAD)


def _beyond(off: NDArray[np.float64], covariance: NDArray[np.float64]) -> bool:
    """Whether a difference (6,) is notable and not chance."""

    def unlikely(part: slice) -> bool:
        return not float(off[part] @ np.linalg.solve(covariance[part, part], off[part])) <= CHI2_LIMIT

    turned, shifted = slice(0, 3), slice(3, 6)
    notable = ((shifted, NOTABLE_M), (turned, NOTABLE_RAD))
    return any(not float(np.linalg.norm(off[part])) <= least and unlikely(part) for part, least in notable)


def _nothing(words: str) -> Verification:
    return Verification((), math.nan, math.nan, None, False, words)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"
