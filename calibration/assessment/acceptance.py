"""Acceptance of a solved calibration: check all limits, and return a finding for each exceeded limit.

The codes of the findings are

    too-few-views, pure-translation, parallel-axes    as in `calibration.input_checks`, for the used views
    poses-shuffled, ..., inconsistent                 the views are inconsistent; the cause is from `diagnosis`
    not-settled                                       the solver did not converge
    uncertain-place, uncertain-direction              the standard deviation of X is too large
    corner-noise                                      the corners are detected too imprecisely
    robot-error                                       the reported flange poses are too imprecise
    left-out-error                                    the leave-one-out error is too large
    focal-length, optical-axis, lens-distortion       the camera differs from the given intrinsics
    board-scale                                       the board does not have the nominal size
    board-scale-unverified                            warning: the views determine the board size too imprecisely
"""

import numpy as np
from numpy.typing import NDArray

from calibration.assessment.board_acceptance import UNVERIFIED_SCALE_SIGMA, board_findings, is_scale_unverified
from calibration.assessment.camera_acceptance import camera_findings
from calibration.assessment.change_point import MIN_VIEWS_PER_SIDE
from calibration.assessment.diagnosis import diagnose
from calibration.assessment.evidence import Evidence
from calibration.assessment.repeatability import estimate_repeatability
from calibration.input_checks.motion_diversity import MIN_ROTATION_RAD, MIN_SECOND_AXIS_RAD, motion_diversity
from calibration.input_checks.observations import MIN_VIEWS
from calibration.result import Finding

MIN_CONSISTENT_SHARE = 0.7
"""Minimum ratio of used views to views with a board pose. If more views are excluded, the used views may be the wrong
views."""
MAX_SIGMA_M = 1e-3
"""Maximum standard deviation of the camera position (root sum of squares over the axes), metres. An unverified board
size is not included; it has its own warning."""
MAX_SIGMA_RAD = np.radians(0.15)
"""Maximum standard deviation of the camera rotation (root sum of squares over the axes), radians. It is 1 mm at
0.4 m."""
MAX_PIXEL_SIGMA_PX = 0.6
"""Maximum standard deviation of the corner noise, pixels. A sharp image of a resting board has a third of this."""
MAX_ROBOT_ERROR_M = 1e-3
"""Maximum robot position error (root sum of squares over the axes), metres. A larger error alone makes a grasp fail."""
MAX_ROBOT_ERROR_RAD = np.radians(0.25)
"""Maximum robot rotation error (root sum of squares over the axes), radians."""
MAX_LOO_ERROR_M = 1.5e-3
"""Maximum leave-one-out error (root mean square), metres, at a short distance from the board."""
MAX_LOO_ERROR_SHARE = 0.002
"""Maximum ratio of the leave-one-out error to the distance, at a long distance from the board."""


def acceptance_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return all findings against a solved calibration, the most serious cause first.

    Args:
        evidence: Solution and views of the calibration.

    Returns:
        The findings; empty if the calibration may be used without reservation.
    """
    findings = (
        _consistency_findings(evidence)
        + _accuracy_findings(evidence)
        + camera_findings(evidence)
        + board_findings(evidence)
    )
    # One mistake may cause much noise or several excluded views. The used views may then be the wrong views.
    codes = {finding.code for finding in findings}
    suspicious = codes & {"inconsistent", "robot-error", "left-out-error"}
    n_rejected = int((_has_board(evidence) & ~evidence.used).sum())
    if not suspicious and n_rejected < MIN_VIEWS_PER_SIDE:
        return findings
    cause = _diagnose(evidence)
    if cause is None or cause.code in codes or (cause.code == "inconsistent" and not suspicious):
        return findings
    return cause, *(finding for finding in findings if finding.code != "inconsistent")


def reported_covariance(evidence: Evidence) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of the error of X, including the uncertainty of an unverified board size.

    An unverified board size adds variance along the optical axis. All reported accuracies follow from the returned
    covariance. The limits of `acceptance_findings` apply to `Evidence.covariance`.
    """
    covariance = evidence.covariance.copy()
    if is_scale_unverified(evidence):
        added = max(UNVERIFIED_SCALE_SIGMA**2 - evidence.board_scale_sigma**2, 0.0)
        covariance[5, 5] += added * _distance_m(evidence) ** 2
    return covariance


def reported_repeatability(evidence: Evidence) -> float:
    """Return the predicted repeatability of a scan, metres, for `HandEyeResult.repeatability_95_m`."""
    return estimate_repeatability(
        reported_covariance(evidence),
        evidence.robot_sigma_rad,
        evidence.robot_sigma_m,
        _distance_m(evidence),
        evidence.lever_m,
    )


def _has_board(evidence: Evidence) -> NDArray[np.bool_]:
    """Return the mask (N,), True for the views with a board pose."""
    return np.asarray(np.isfinite(evidence.T_camera_board).all(axis=(1, 2)))


def _diagnose(evidence: Evidence) -> Finding | None:
    """Diagnose the views with a board pose."""
    with_board = np.flatnonzero(_has_board(evidence))
    names = tuple(evidence.names[index] for index in with_board)
    return diagnose(evidence.T_base_flange[with_board], evidence.T_camera_board[with_board], evidence.mounting, names)


def _consistency_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings about the number of used views and the diversity of their rotations."""
    findings = []
    count = int(_has_board(evidence).sum())
    used = int(evidence.used.sum())
    if used < MIN_CONSISTENT_SHARE * count:
        findings.append(
            _refusal(
                "inconsistent",
                f"only {used} of {count} views agree with one another, and {np.ceil(MIN_CONSISTENT_SHARE * count):.0f} "
                "are needed: fasten the board and the camera, let the arm come to rest before each image, read its "
                "pose with the image, and start again",
            )
        )
    if used < MIN_VIEWS:
        findings.append(
            _refusal(
                "too-few-views",
                f"only {used} views agree and show the board well, and {MIN_VIEWS} are needed (12 to 15 are good): add "
                "views",
            )
        )
    if used >= 2:
        diversity = motion_diversity(evidence.T_base_flange[evidence.used])
        if diversity.max_rotation_rad < MIN_ROTATION_RAD:
            findings.append(_refusal("pure-translation", diversity.pure_translation_message()))
        elif diversity.second_axis_rad < MIN_SECOND_AXIS_RAD:
            findings.append(_refusal("parallel-axes", diversity.parallel_axes_message()))
    return tuple(findings)


def _accuracy_findings(evidence: Evidence) -> tuple[Finding, ...]:
    """Return the findings about convergence, the covariance of X, the noise levels and the leave-one-out error."""
    findings: list[Finding] = []
    if not evidence.converged:
        findings.append(
            _refusal(
                "not-settled",
                "the solver did not converge: check that each image and its pose belong together, "
                "and add views with more tilt and roll, from two distances",
            )
        )
    findings.extend(_covariance_findings(evidence))
    if not evidence.pixel_sigma_px <= MAX_PIXEL_SIGMA_PX:
        findings.append(
            _refusal(
                "corner-noise",
                f"the noise of the corners is {evidence.pixel_sigma_px:.2f} pixels, and at most {MAX_PIXEL_SIGMA_PX:g} "
                "is accepted: lay the board flat, light it evenly, focus and lock the lens, let the arm come to rest, "
                "and check that K is of this stream and resolution",
            )
        )
    findings.extend(_robot_findings(evidence))
    limit = max(MAX_LOO_ERROR_M, MAX_LOO_ERROR_SHARE * _distance_m(evidence))
    if not evidence.loo_error_m <= limit:
        findings.append(
            _refusal(
                "left-out-error",
                f"the leave-one-out error of the views is {1e3 * evidence.loo_error_m:.2f} mm (rms), and at most "
                f"{1e3 * limit:.2f} is accepted: check the views with the largest errors, and take more views",
            )
        )
    return tuple(findings)


def _covariance_findings(evidence: Evidence) -> list[Finding]:
    """Return the findings about the covariance of X."""
    findings = []
    with np.errstate(invalid="ignore"):  # NaN fails each `not <=` below
        sigma_m = float(np.sqrt(np.trace(evidence.covariance[3:, 3:])))
        sigma_rad = float(np.sqrt(np.trace(evidence.covariance[:3, :3])))
    more = "add views with more tilt and roll, from two distances"
    if not sigma_m <= MAX_SIGMA_M:
        findings.append(
            _refusal(
                "uncertain-place",
                f"the position of the camera is uncertain by {1e3 * sigma_m:.2f} mm, and at most {1e3 * MAX_SIGMA_M:g} "
                f"mm is accepted: {more}",
            )
        )
    if not sigma_rad <= MAX_SIGMA_RAD:
        findings.append(
            _refusal(
                "uncertain-direction",
                f"the rotation of the camera is uncertain by {np.degrees(sigma_rad):.2f} degrees, and at most "
                f"{np.degrees(MAX_SIGMA_RAD):.2f} is accepted: {more}",
            )
        )
    return findings


def _robot_findings(evidence: Evidence) -> list[Finding]:
    """Return the finding about the errors of the reported flange poses, if the errors are too large."""
    # The estimates are per axis. The limits are for the root sum of squares over the three axes.
    error_m = np.sqrt(3.0) * evidence.robot_sigma_m
    error_rad = np.sqrt(3.0) * evidence.robot_sigma_rad
    if error_m <= MAX_ROBOT_ERROR_M and error_rad <= MAX_ROBOT_ERROR_RAD:
        return []
    return [
        _refusal(
            "robot-error",
            f"the arm was {1e3 * error_m:.2f} mm and {np.degrees(error_rad):.2f} degrees from its reported poses "
            f"(rms), and at most {1e3 * MAX_ROBOT_ERROR_M:g} mm and {np.degrees(MAX_ROBOT_ERROR_RAD):.2f} degrees is "
            "accepted: check that board and camera are firm, that the arm was at rest, and that its own calibration is "
            "loaded",
        )
    ]


def _distance_m(evidence: Evidence) -> float:
    """Return the mean distance from the camera to the board over the used views, metres."""
    return float(evidence.distance_m[evidence.used].mean())


def _refusal(code: str, message: str) -> Finding:
    """Return a blocking finding."""
    return Finding(code, message, blocking=True)
