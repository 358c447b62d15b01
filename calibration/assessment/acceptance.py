"""Whether a solved calibration may be used: every limit, and the words for what exceeds it.

A finding's code is one of

    too-few-views, pure-translation, parallel-axes    as in `calibration.input_checks`, of the views that agree
    poses-shuffled, ..., inconsistent                 the views do not agree: why, by `calibration.assessment.diagnosis`
    not-settled                                       no solution was reached from the pictures
    uncertain-place, uncertain-direction              X's own standard deviation
    corner-noise                                      the corners are found too roughly
    robot-error                                       the arm was not where it said
    left-out-error                                    views are not predicted by the others
    focal-length, optical-axis, lens-distortion       the camera is not the told one, by `camera_acceptance`
    board-scale                                       the board is not as large as told
    board-scale-unverified                            a warning: the views cannot tell how large it is
"""

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.camera_acceptance import camera_findings
from calibration.assessment.change_point import SHORTEST
from calibration.assessment.diagnosis import diagnose
from calibration.assessment.evidence import Evidence
from calibration.assessment.repeatability import repeatability_bound
from calibration.input_checks.motion_diversity import PARALLEL_AXES_RAD, PURE_TRANSLATION_RAD, motion_diversity
from calibration.input_checks.observations import FEWEST_VIEWS
from calibration.result import Finding

FEWEST_CONSISTENT = 0.7
"""Share of the views that must agree with one another, of those in which the board's pose was found: with more left
out, the wrong ones may be those that agree."""
LARGEST_SIGMA_M = 1e-3
"""Of X's place, all axes together, by its covariance: without what an unverified board size adds to it, which is told
and warned of."""
LARGEST_SIGMA_RAD = np.radians(0.15)
"""Of X's direction: 1 mm at 0.4 m."""
LARGEST_PIXEL_SIGMA_PX = 0.6
"""Three times what a sharp, still picture gives."""
LARGEST_ROBOT_ERROR_M = 1e-3
"""Root mean square over the views, all axes together: an arm that is worse by itself ruins a grasp."""
LARGEST_ROBOT_ERROR_RAD = np.radians(0.25)
LARGEST_LEFT_OUT_M = 1.5e-3
"""Root mean square of how far a view is from what the others predict, near by ..."""
LARGEST_LEFT_OUT_SHARE = 0.002
"""... and as a share of the distance, far away."""
LARGEST_SCALE_CHANGE = 0.003
"""Of the board's size: 1 mm at 0.35 m. More is a print that was scaled."""
LARGEST_SCALE_SIGMAS = 4.0
"""So many standard deviations may the board's size be off by chance."""
LARGEST_SCALE_SIGMA = 0.0015
"""Standard deviation of the board's size from which on the views have not verified it: hardly below the prior's."""
UNVERIFIED_SCALE_SIGMA = 0.005
"""What is assumed of the board's size where the views have not verified it: 1 mm of 200 mm measured with a ruler. A
print that was scaled to fit its paper is farther off: its check line is there to be measured."""


def acceptance_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """What speaks against using the calibration; empty: nothing. The gravest cause comes first."""
    findings = _views(evidence) + _accuracy(evidence) + camera_findings(evidence) + _board(evidence)
    # Much noise, or several views left out, may have one cause; and then those that were kept may be the wrong ones.
    codes = {finding.code for finding in findings}
    suspicious = codes & {"inconsistent", "robot-error", "left-out-error"}
    disagreeing = int((_seen(evidence) & ~evidence.used).sum())
    cause = _cause(evidence) if suspicious or disagreeing >= SHORTEST else None
    if cause is None or cause.code in codes or (cause.code == "inconsistent" and not suspicious):
        return findings
    return cause, *(finding for finding in findings if finding.code != "inconsistent")


def reported_covariance(evidence: Evidence) -> NDArray[np.float64]:
    """X's covariance (6, 6), grown by what an unverified board size adds: all places shift along the view.

    Everything that a user is told follows from this one; the limits of `acceptance_findings` are of
    `Evidence.covariance`.
    """
    covariance = evidence.covariance.copy()
    if _scale_unverified(evidence):
        sigma = evidence.board_scale_sigma or 0.0
        added = max(UNVERIFIED_SCALE_SIGMA**2 - sigma**2, 0.0)
        covariance[5, 5] += added * _distance_m(evidence) ** 2
    return covariance


def reported_repeatability(evidence: Evidence) -> float:
    """Predicted bound of the disagreement of a scan's views, as in `HandEyeResult`."""
    return repeatability_bound(
        reported_covariance(evidence),
        evidence.robot_sigma_rad,
        evidence.robot_sigma_m,
        _distance_m(evidence),
        evidence.lever_m,
    )


def _seen(evidence: Evidence) -> NDArray[np.bool_]:
    """(N,) the views that gave a board pose."""
    return np.asarray(np.isfinite(evidence.T_camera_board).all(axis=(1, 2)))


def _cause(evidence: Evidence) -> Finding | None:
    """Of views that do not fit, by their poses."""
    seen = np.flatnonzero(_seen(evidence))
    names = tuple(evidence.names[index] for index in seen)
    return diagnose(evidence.T_base_flange[seen], evidence.T_camera_board[seen], evidence.mounting, names)


def _views(evidence: Evidence) -> tuple[Finding, ...]:
    findings = []
    count, used = int(_seen(evidence).sum()), int(evidence.used.sum())
    if used < FEWEST_CONSISTENT * count:
        findings.append(
            _refusal(
                "inconsistent",
                f"only {used} of {count} views agree with one another, and {np.ceil(FEWEST_CONSISTENT * count):.0f} "
                "are needed: fasten the board and the camera, let the arm come to rest before each picture, read its "
                "pose with the picture, and begin anew",
            )
        )
    if used < FEWEST_VIEWS:
        findings.append(
            _refusal(
                "too-few-views",
                f"{used} views agree and show the board well, and {FEWEST_VIEWS} are needed (12 to 15 are good): add "
                "views",
            )
        )
    if used >= 2:
        spread = motion_diversity(evidence.T_base_flange[evidence.used])
        if spread.largest_rad < PURE_TRANSLATION_RAD:
            findings.append(_refusal("pure-translation", spread.too_little_words()))
        elif spread.second_axis_rad < PARALLEL_AXES_RAD:
            findings.append(_refusal("parallel-axes", spread.parallel_words()))
    return tuple(findings)


def _accuracy(evidence: Evidence) -> tuple[Finding, ...]:
    findings = []
    if not evidence.settled:
        findings.append(
            _refusal(
                "not-settled",
                "the solution still moved after the last step: check that each picture and its pose belong together, "
                "and add views with more tilt and roll, from two distances",
            )
        )
    with np.errstate(invalid="ignore"):  # a covariance that is none is refused too: "not <="
        sigma_m = float(np.sqrt(np.trace(evidence.covariance[3:, 3:])))
        sigma_rad = float(np.sqrt(np.trace(evidence.covariance[:3, :3])))
    more = "add views with more tilt and roll, from two distances"
    if not sigma_m <= LARGEST_SIGMA_M:
        findings.append(
            _refusal(
                "uncertain-place",
                f"the camera's place is known to {1e3 * sigma_m:.2f} mm only, and {1e3 * LARGEST_SIGMA_M:g} mm is "
                f"needed: {more}",
            )
        )
    if not sigma_rad <= LARGEST_SIGMA_RAD:
        findings.append(
            _refusal(
                "uncertain-direction",
                f"the camera's direction is known to {np.degrees(sigma_rad):.2f} degrees only, and "
                f"{np.degrees(LARGEST_SIGMA_RAD):.2f} is needed: {more}",
            )
        )
    if evidence.pixel_sigma_px is not None and not evidence.pixel_sigma_px <= LARGEST_PIXEL_SIGMA_PX:
        findings.append(
            _refusal(
                "corner-noise",
                f"corners are off by {evidence.pixel_sigma_px:.2f} pixels, and up to {LARGEST_PIXEL_SIGMA_PX:g} is "
                "taken: lay the board flat, light it evenly, focus and lock the lens, let the arm come to rest, and "
                "check that K is of this stream and resolution",
            )
        )
    findings.extend(_robot_errors(evidence))
    limit = max(LARGEST_LEFT_OUT_M, LARGEST_LEFT_OUT_SHARE * _distance_m(evidence))
    if not evidence.left_out_m <= limit:
        findings.append(
            _refusal(
                "left-out-error",
                f"views are {1e3 * evidence.left_out_m:.2f} mm from where the others predict them (rms), and up to "
                f"{1e3 * limit:.2f} is taken: see the views that are farthest off, and take more views",
            )
        )
    return tuple(findings)


def _robot_errors(evidence: Evidence) -> list[Finding]:
    # The estimate is of one axis; a person at the arm means all three together.
    off_m, off_rad = np.sqrt(3.0) * evidence.robot_sigma_m, np.sqrt(3.0) * evidence.robot_sigma_rad
    if off_m <= LARGEST_ROBOT_ERROR_M and off_rad <= LARGEST_ROBOT_ERROR_RAD:
        return []
    return [
        _refusal(
            "robot-error",
            f"the arm was {1e3 * off_m:.2f} mm and {np.degrees(off_rad):.2f} degrees from where it said (rms), and up "
            f"to {1e3 * LARGEST_ROBOT_ERROR_M:g} mm and {np.degrees(LARGEST_ROBOT_ERROR_RAD):.2f} degrees are taken: "
            "check that board and camera sit firmly, that the arm was at rest, and that its own calibration is loaded",
        )
    ]


def _board(evidence: Evidence) -> tuple[Finding, ...]:
    findings = []
    scale, sigma = evidence.board_scale, evidence.board_scale_sigma
    if scale is not None and sigma is not None:
        limit = max(LARGEST_SCALE_CHANGE, LARGEST_SCALE_SIGMAS * sigma)
        if not abs(scale - 1.0) <= limit:
            findings.append(
                _refusal(
                    "board-scale",
                    f"by the views the board is {100 * (scale - 1.0):+.2f} % off the size told, and up to "
                    f"{100 * limit:.2f} % is taken: print it true to scale (100 %, not fitted to the page), measure it "
                    "with a caliper over many squares, and give the pitch measured",
                )
            )
    if _scale_unverified(evidence):
        findings.append(
            Finding(
                "board-scale-unverified",
                f"the views tell the board's size to {100 * (sigma or 0.0):.2f} % only, and "
                f"{100 * LARGEST_SCALE_SIGMA:.2f} % is needed to verify it: measure the board with a caliper, or add "
                "views from a second distance",
                refuses=False,
            )
        )
    return tuple(findings)


def _scale_unverified(evidence: Evidence) -> bool:
    sigma = evidence.board_scale_sigma
    return sigma is not None and not sigma <= LARGEST_SCALE_SIGMA


def _distance_m(evidence: Evidence) -> float:
    """Mean distance of the views used."""
    distances = evidence.distance_m[evidence.used & np.isfinite(evidence.distance_m)]
    return float(distances.mean()) if len(distances) else 0.0


def _refusal(code: str, words: str) -> Finding:
    return Finding(code, words, refuses=True)
