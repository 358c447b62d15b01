"""Every limit is tested from both sides. Its message has a code, the measured value, the limit and an action."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.assessment.acceptance import (
    acceptance_findings,
    reported_covariance,
    reported_repeatability,
)
from calibration.assessment.board_acceptance import UNVERIFIED_SCALE_SIGMA
from calibration.assessment.evidence import Evidence
from calibration.geometry.transforms import from_rotation_vector
from tests.calibration.board_views import realistic_plan, record

RECORDED = record(seed=1, count=12, plan=realistic_plan)
SIGMA_M, SIGMA_RAD = 2e-4, float(np.radians(0.03))
GOOD = Evidence(
    mounting="eye-in-hand",
    names=tuple(view.name for view in RECORDED.observations.views),
    T_base_flange=RECORDED.T_base_flange,
    T_camera_board=RECORDED.T_camera_board,
    used=np.ones(12, dtype=bool),
    distance_m=np.full(12, 0.4),
    X=RECORDED.X,
    Y=RECORDED.Y,
    covariance=np.diag([SIGMA_RAD**2 / 3] * 3 + [SIGMA_M**2 / 3] * 3),
    robot_sigma_m=1e-4,
    robot_sigma_rad=float(np.radians(0.02)),
    loo_error_m=4e-4,
    lever_m=np.array([0.0, 0.0, 0.5]),
    pixel_sigma_px=0.2,
    K_nominal=RECORDED.K,
    K=RECORDED.K,
    k1=0.0,
    k1_sigma=0.002,
    board_scale=1.0,
    board_scale_sigma=0.001,
    converged=True,
)


def codes(evidence: Evidence) -> list[str]:
    return [finding.code for finding in acceptance_findings(evidence)]


def with_sigmas(sigma_m: float, sigma_rad: float) -> Evidence:
    """Return evidence with these sigmas of position and direction, all axes together."""
    return replace(GOOD, covariance=np.diag([sigma_rad**2 / 3] * 3 + [sigma_m**2 / 3] * 3))


def with_focal(share: float, axis: int = 0) -> Evidence:
    K = RECORDED.K.copy()
    K[axis, axis] *= 1 + share
    return replace(GOOD, K=K)


def with_centre(x_px: float, y_px: float) -> Evidence:
    K = RECORDED.K.copy()
    K[:2, 2] += (x_px, y_px)
    return replace(GOOD, K=K)


def using(count: int) -> Evidence:
    return replace(GOOD, used=np.arange(12) < count)


def test_a_good_calibration_passes():
    assert acceptance_findings(GOOD) == ()


def test_a_solution_that_did_not_converge_is_refused():
    finding = acceptance_findings(replace(GOOD, converged=False))[0]
    assert finding.code == "not-settled"
    assert finding.blocking


@pytest.mark.parametrize(
    ("evidence", "code", "measured", "limit"),
    [
        (with_sigmas(1.1e-3, SIGMA_RAD), "uncertain-place", "1.10 mm", "1 mm"),
        (with_sigmas(SIGMA_M, np.radians(0.16)), "uncertain-direction", "0.16 degrees", "0.15"),
        (replace(GOOD, pixel_sigma_px=0.65), "corner-noise", "0.65 pixels", "0.6"),
        (replace(GOOD, robot_sigma_m=1.1e-3 / np.sqrt(3)), "robot-error", "1.10 mm", "1 mm"),
        (replace(GOOD, robot_sigma_rad=np.radians(0.26) / np.sqrt(3)), "robot-error", "0.26 degrees", "0.25"),
        (replace(GOOD, loo_error_m=1.6e-3), "left-out-error", "1.60 mm", "1.50"),
        (with_focal(0.011), "focal-length", "+1.10 %", "1 %"),
        (with_focal(-0.011, axis=1), "focal-length", "-1.10 %", "1 %"),
        (replace(GOOD, K=RECORDED.K @ np.diag([1.003, 0.997, 1.0])), "focal-length", "+0.60 %", "0.5 %"),
        (with_centre(6.5, 0.0), "optical-axis", "+6.5", "6.0"),
        (with_centre(3.0, -7.0), "optical-axis", "-7.0", "6.0"),
        (replace(GOOD, k1=-0.03, k1_sigma=0.002), "lens-distortion", "-0.030", "0.015"),
        (replace(GOOD, k1=0.03, k1_sigma=0.004), "lens-distortion", "+0.030", "0.024"),
        (replace(GOOD, board_scale=1.0045), "board-scale", "+0.45 %", "0.40 %"),
        (replace(GOOD, board_scale=0.9965, board_scale_sigma=0.0005), "board-scale", "-0.35 %", "0.30 %"),
        (using(7), "too-few-views", "7 views", "8"),
    ],
)
def test_a_value_beyond_a_limit_is_refused(evidence, code, measured, limit):
    findings = {finding.code: finding for finding in acceptance_findings(evidence)}
    assert findings[code].blocking
    assert measured in findings[code].message
    said, to_do = findings[code].message.split(":", maxsplit=1)
    assert limit in said
    assert to_do.strip()


@pytest.mark.parametrize(
    "evidence",
    [
        with_sigmas(0.95e-3, np.radians(0.14)),
        replace(GOOD, pixel_sigma_px=0.59),
        replace(GOOD, robot_sigma_m=0.95e-3 / np.sqrt(3), robot_sigma_rad=np.radians(0.24) / np.sqrt(3)),
        replace(GOOD, loo_error_m=1.45e-3),
        replace(GOOD, loo_error_m=1.9e-3, distance_m=np.full(12, 1.0)),
        with_focal(0.0045),
        replace(GOOD, K=RECORDED.K @ np.diag([1.0095, 1.0095, 1.0])),
        with_centre(-5.5, 5.5),
        replace(GOOD, k1=0.014, k1_sigma=0.001),
        replace(GOOD, k1=0.03, k1_sigma=0.006),
        replace(GOOD, board_scale=1.0029, board_scale_sigma=0.0005),
        replace(GOOD, board_scale=1.0039, board_scale_sigma=0.001),
        using(9),
    ],
)
def test_a_value_within_a_limit_is_accepted(evidence):
    assert acceptance_findings(evidence) == ()


def test_one_fault_gives_one_finding():
    assert codes(with_focal(0.02)) == ["focal-length"]
    assert codes(replace(GOOD, board_scale=1.01)) == ["board-scale"]


def test_less_than_seven_tenths_of_consistent_views_are_refused():
    # Two of three views agree, and the others have no common cause.
    (finding,) = acceptance_findings(using(8))
    assert finding.code == "inconsistent"
    assert "8 of 12" in finding.message
    assert "9 are needed" in finding.message


def test_views_without_a_board_pose_do_not_count():
    # Four of twelve views show too little of the board. The other eight agree.
    B = RECORDED.T_camera_board.copy()
    B[8:] = np.nan
    assert acceptance_findings(replace(using(8), T_camera_board=B)) == ()
    # Six of ten views with a pose agree.
    B = RECORDED.T_camera_board.copy()
    B[10:] = np.nan
    found = {finding.code: finding.message for finding in acceptance_findings(replace(using(6), T_camera_board=B))}
    assert "6 of 10" in found["inconsistent"]
    assert "7 are needed" in found["inconsistent"]


def test_a_known_cause_replaces_the_finding_of_inconsistency():
    B = RECORDED.T_camera_board.copy()
    B[6:] = B[6:] @ from_rotation_vector([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])
    findings = acceptance_findings(replace(using(6), T_camera_board=B))
    assert [finding.code for finding in findings] == ["board-moved", "too-few-views"]
    assert "from view 07 on" in findings[0].message


def test_a_few_bad_views_have_no_common_cause():
    B = RECORDED.T_camera_board.copy()
    bad = [2, 5, 9]
    B[bad] = B[bad] @ from_rotation_vector([0.03, 0.01, 0.0], [0.0, 0.1, 0.0])
    assert acceptance_findings(replace(GOOD, T_camera_board=B, used=~np.isin(np.arange(12), bad))) == ()


def test_three_excluded_views_at_one_end_may_be_correct():
    A = RECORDED.T_base_flange.copy()
    A[3:] = A[3:] @ from_rotation_vector([0.0, 0.0, 0.12], [0.0, 0.0, 0.3])
    (finding,) = acceptance_findings(replace(GOOD, T_base_flange=A, used=np.arange(12) >= 3))
    assert finding.code == "tcp-changed"
    assert "from view 04 on" in finding.message


def test_views_without_a_pose_are_excluded_from_the_diagnosis():
    B = RECORDED.T_camera_board.copy()
    B[6:] = B[6:] @ from_rotation_vector([0.01, 0.0, 0.0], [0.0, 0.0, 0.0])
    B[1] = np.nan
    findings = acceptance_findings(replace(using(6), T_camera_board=B))
    assert findings[0].code == "board-moved"
    assert "from view 07 on" in findings[0].message


def test_the_consistent_views_need_enough_rotation():
    turned = RECORDED.T_base_flange.copy()
    turned[:9, :3, :3] = turned[0, :3, :3]
    assert codes(replace(using(9), T_base_flange=turned)) == ["pure-translation"]
    about_one_axis = RECORDED.T_base_flange.copy()
    for k in range(9):
        about_one_axis[k] = about_one_axis[0] @ from_rotation_vector([0, 0, 0], [0, 0, 0.1 * k])
    assert codes(replace(using(9), T_base_flange=about_one_axis)) == ["parallel-axes"]


def test_an_unverified_board_size_is_a_warning_and_increases_the_covariance():
    evidence = replace(GOOD, board_scale_sigma=0.0019)
    (finding,) = acceptance_findings(evidence)
    assert finding.code == "board-scale-unverified"
    assert not finding.blocking
    assert "0.19 %" in finding.message
    grown = reported_covariance(evidence) - evidence.covariance
    # The position shifts along the view by the share of the distance that the covariance does not contain yet.
    expected = np.zeros((6, 6))
    expected[5, 5] = (UNVERIFIED_SCALE_SIGMA**2 - 0.0019**2) * 0.4**2
    np.testing.assert_allclose(grown, expected, atol=1e-15)


def test_the_repeatability_includes_an_unverified_board_size():
    # An error of 2 mm along the view separates views from all sides by nearly as much.
    open_size = replace(GOOD, board_scale_sigma=0.0019)
    assert reported_repeatability(open_size) > reported_repeatability(GOOD) + 0.001


def test_an_unverified_board_size_alone_is_not_refused():
    open_size = replace(GOOD, board_scale_sigma=0.002)
    assert np.sqrt(np.trace(reported_covariance(open_size)[3:, 3:])) > 1e-3
    assert not any(finding.blocking for finding in acceptance_findings(open_size))


def test_a_verified_board_size_does_not_change_the_covariance():
    np.testing.assert_array_equal(reported_covariance(GOOD), GOOD.covariance)


@pytest.mark.parametrize(
    "evidence",
    [
        replace(GOOD, covariance=np.full((6, 6), np.nan)),
        replace(GOOD, pixel_sigma_px=np.nan),
        replace(GOOD, robot_sigma_m=np.nan),
        replace(GOOD, loo_error_m=np.nan),
        replace(GOOD, K=np.full((3, 3), np.nan)),
        replace(GOOD, k1=np.nan, k1_sigma=0.003),
        replace(GOOD, board_scale=np.nan),
    ],
)
def test_a_value_that_is_not_a_number_is_refused(evidence):
    assert any(finding.blocking for finding in acceptance_findings(evidence))
