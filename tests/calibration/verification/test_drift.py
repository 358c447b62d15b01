"""Drift of a calibration by scans with known errors."""

import numpy as np
import pytest

from calibration.verification.drift import LATEST_SCANS, MAX_P_VALUE, MAX_SCANS, MIN_SCANS, ScanLikelihood, judge_drift

CALIBRATION = np.diag(np.repeat([0.001, 0.0004], 3) ** 2)
SCAN_SIGMA = np.array([0.0006, 0.0012, 0.002, 0.0007, 0.0004, 0.0005])
"""Standard deviations of a scan (6,), radians and metres, which differ by direction as in registered scans."""


def scan(error: np.ndarray, sigma: np.ndarray = SCAN_SIGMA, axes: np.ndarray | None = None) -> ScanLikelihood:
    """Return a scan that measures `error` (6,) with these sigmas along `axes`."""
    Q = np.eye(6) if axes is None else axes
    information = Q @ np.diag(sigma**-2.0) @ Q.T
    return ScanLikelihood(information, information @ error)


def test_false_alarms_have_their_probability() -> None:
    rng = np.random.default_rng(5)
    chances, alarms = [], 0
    for _ in range(400):
        # The worst case: the robot has the same error in all scans.
        error = np.sqrt(np.diag(CALIBRATION)) * rng.standard_normal(6) + SCAN_SIGMA * rng.standard_normal(6)
        drift = judge_drift([scan(error)] * 5, CALIBRATION)
        chances.append(drift.p_value)
        alarms += drift.drifted
    # Uniform from 0 to 1: a mean of 0.5 +- 0.014. 8 +- 2.8 of 400 are below 0.02.
    assert np.mean(chances) == pytest.approx(0.5, abs=0.05)
    assert alarms <= 400 * MAX_P_VALUE + 9


@pytest.mark.parametrize("axis", range(6))
def test_a_drift_is_reported_with_its_size(axis: int) -> None:
    off = np.zeros(6)
    off[axis] = np.radians(0.5) if axis < 3 else 0.004  # 4 to 7 sigma
    drift = judge_drift([scan(off)] * MIN_SCANS, CALIBRATION)
    assert drift.drifted
    assert drift.p_value < MAX_P_VALUE
    # The prior reduces the error of the scans by a small share: (2 mrad / 17.5 mrad)^2 at most.
    np.testing.assert_allclose(drift.error, off, rtol=0.03, atol=1e-12)
    assert ("mm and 0.00 degrees" if axis >= 3 else "0.0 mm and 0.") in drift.message
    assert "calibrate again" in drift.message


def test_directions_without_information_do_not_count() -> None:
    # The scan has information in two of six oblique directions. In the others, the error is arbitrary.
    Q = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 6)))[0]
    # The columns have comparable units, which radians and metres are not.
    units = np.diag(np.repeat([0.001, 0.0004], 3))
    information = np.linalg.inv(units) @ Q @ np.diag([4.0, 4.0, 0, 0, 0, 0]) @ Q.T @ np.linalg.inv(units)
    hidden = units @ Q[:, 2] * 100
    shown = units @ Q[:, 0] * 10
    assert judge_drift([ScanLikelihood(information, information @ hidden)] * 4, CALIBRATION).p_value > 0.99
    assert judge_drift([ScanLikelihood(information, information @ shown)] * 4, CALIBRATION).drifted
    nothing = ScanLikelihood(np.zeros((6, 6)), np.zeros(6))
    drift = judge_drift([nothing] * 4, CALIBRATION)
    assert (drift.p_value, drift.drifted, drift.deviation_m, drift.deviation_rad) == (1.0, False, 0.0, 0.0)


def test_many_scans_from_the_same_viewpoints_count_as_one() -> None:
    off = 1.5 * SCAN_SIGMA
    one, many = judge_drift([scan(off)], CALIBRATION), judge_drift([scan(off)] * MAX_SCANS, CALIBRATION)
    assert many.p_value == pytest.approx(one.p_value, rel=1e-9)
    np.testing.assert_allclose(many.error, one.error, rtol=1e-9, atol=0)


def test_weak_scans_count_little() -> None:
    strong, weak = scan(np.zeros(6)), scan(np.full(6, 0.01), SCAN_SIGMA * 100)
    drift = judge_drift([strong, weak, weak, weak], CALIBRATION)
    # Each has 1/10,000 of the weight: 3 micrometres of their 10 mm.
    assert drift.deviation_m < 0.0001
    assert drift.p_value > 0.9
    alone = judge_drift([scan(np.full(6, 0.004))] * 3, CALIBRATION)
    among_weak = judge_drift([scan(np.full(6, 0.004))] * 3 + [scan(np.zeros(6), SCAN_SIGMA * 100)] * 10, CALIBRATION)
    assert alone.drifted
    assert among_weak.drifted
    np.testing.assert_allclose(among_weak.error, alone.error, rtol=0.08, atol=0.0)


def test_one_wrong_scan_is_not_a_drift() -> None:
    good, wrong = scan(np.zeros(6)), scan(np.full(6, 0.02))
    for count in (2, 5, MAX_SCANS - 1):
        assert not judge_drift([good] * count + [wrong], CALIBRATION).drifted
    assert not judge_drift([wrong] * (MIN_SCANS - 1), CALIBRATION).drifted
    assert judge_drift([wrong] * MIN_SCANS, CALIBRATION).drifted


@pytest.mark.parametrize(("count", "expected"), [(0, "there are none"), (1, "there is 1, by"), (2, "there are 2, by")])
def test_too_few_scans_report_no_drift(count: int, expected: str) -> None:
    message = judge_drift([scan(np.zeros(6))] * count, CALIBRATION).message
    assert f"whether the calibration has drifted: {MIN_SCANS} scans with it are needed, and {expected}" in message
    assert "agree" not in message
    assert "agree with the calibration" in judge_drift([scan(np.zeros(6))] * MIN_SCANS, CALIBRATION).message


def test_scans_with_one_wrong_scan_do_not_agree() -> None:
    drift = judge_drift([scan(np.zeros(6))] * 2 + [scan(np.full(6, 0.02))], CALIBRATION)
    assert (drift.p_value < MAX_P_VALUE, drift.drifted) == (True, False)
    assert "do not agree with the calibration" in drift.message
    assert "Without one of these scans they agree" in drift.message


def test_only_recent_scans_count() -> None:
    drifted, correct = [scan(np.full(6, 0.01))] * 5, [scan(np.zeros(6))] * MAX_SCANS
    drift = judge_drift(drifted + correct, CALIBRATION)
    assert (drift.scans, drift.drifted, drift.deviation_m) == (MAX_SCANS, False, 0.0)


def test_a_displaced_camera_is_detected_within_some_scans() -> None:
    before = [scan(np.zeros(6))] * MAX_SCANS
    knocked = scan(np.full(6, 0.01))
    assert not judge_drift([*before, knocked], CALIBRATION).drifted
    drift = judge_drift(before + [knocked] * LATEST_SCANS, CALIBRATION)
    assert (drift.drifted, drift.scans) == (True, LATEST_SCANS)
    assert drift.deviation_m == pytest.approx(0.01 * np.sqrt(3), rel=0.05)


def test_a_displacement_that_cancels_the_calibration_error_is_detected() -> None:
    was, now = np.array([0, 0, 0, 0, -0.0015, 0]), np.array([0, 0, 0, 0, 0.0015, 0])
    first, latest = [scan(was)] * LATEST_SCANS, [scan(now)] * LATEST_SCANS
    assert not judge_drift(first, CALIBRATION).drifted
    assert not judge_drift(first + latest, CALIBRATION).drifted
    drift = judge_drift(first + latest, CALIBRATION, first)
    assert (drift.drifted, drift.reference, drift.scans) == (True, "first-scans", LATEST_SCANS)
    np.testing.assert_allclose(drift.error, now - was, rtol=0.03, atol=1e-9)
    assert "from where the first scans" in drift.message
    # It is not reported with a wrong scan or with too few first scans.
    assert not judge_drift([*first, *first, scan(now)], CALIBRATION, first).drifted
    assert not judge_drift(first + latest, CALIBRATION, first[: MIN_SCANS - 1]).drifted


def test_first_scans_with_little_information_report_no_drift() -> None:
    first, latest = [scan(np.full(6, -0.002), SCAN_SIGMA * 10)] * LATEST_SCANS, [scan(np.zeros(6))] * LATEST_SCANS
    assert not judge_drift(first + latest, CALIBRATION, first).drifted
    assert not judge_drift(latest + first, CALIBRATION, latest).drifted


def test_without_a_scan_there_is_no_drift() -> None:
    drift = judge_drift([], CALIBRATION)
    assert (drift.scans, drift.p_value, drift.drifted) == (0, 1.0, False)
    assert drift.error.tolist() == [0.0] * 6


def test_the_drift_limit_is_smaller_for_a_precise_calibration() -> None:
    off = np.array([0, 0, 0, 0, 0.0015, 0])
    assert not judge_drift([scan(off)] * 5, CALIBRATION).drifted
    assert judge_drift([scan(off)] * 5, CALIBRATION / 25).p_value < judge_drift([scan(off)] * 5, CALIBRATION).p_value
    assert judge_drift([scan(off * 1.4)] * 5, CALIBRATION / 25).drifted
