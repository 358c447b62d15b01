"""Drift of a calibration, estimated from the scans that were made with it.

Each scan gives a Gaussian likelihood of the hand-eye error (`ScanError`). The scans of a cell use the same viewpoints,
where the robot has the same errors each time. The errors of the scans are therefore taken as fully correlated: their
average is as uncertain as one scan.

The average is compared with the calibration, and with the first scans that were made with it. The second test finds a
camera that was knocked later, even if the knock compensates an error of the calibration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

MAX_SCANS = 20
"""Number of recent scans that are tested together."""
LATEST_SCANS = 5
"""Number of latest scans that are also tested alone, so that earlier scans do not hide a knocked camera."""
MIN_SCANS = 3
"""Minimum number of scans for an alarm, since something may have been moved during one of them."""
MAX_P_VALUE = 0.02
"""Maximum p-value of a drift. Registration assumes larger errors of robot and camera than there are, so false alarms
are far more rare: none of 24 simulated cells had a p-value below 0.2."""
PRIOR_SIGMA_M, PRIOR_SIGMA_RAD = 0.005, 0.0175
"""Prior of the size of a drift, one sigma. It keeps the estimate small in directions that strings do not
constrain."""
_PRIOR_INFORMATION = np.diag(np.repeat([PRIOR_SIGMA_RAD, PRIOR_SIGMA_M], 3) ** -2.0)
MIN_INFORMATION_SHARE = 1e-6
"""Directions in which the scans have less than this share of the information of the calibration are ignored."""


@dataclass(frozen=True, eq=False)
class ScanError:
    """Likelihood of the hand-eye error `c` (6,) by one scan, without any prior.

    `c` is a rotation vector and a translation in the camera frame, radians and metres:
    `T_flange_camera_true = T_flange_camera @ from_rotation_vector(c[3:], c[:3])`.
    """

    information: NDArray[np.float64]
    """(6, 6) inverse covariance; may be singular."""
    vector: NDArray[np.float64]
    """(6,) `information @ c` at the most likely c."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Result of the drift test."""

    scans: int
    """Number of scans that were tested."""
    error: NDArray[np.float64]
    """(6,) most likely hand-eye error, as in `ScanError`."""
    p_value: float
    """Probability of an error of at least this size without a drift."""
    drifted: bool
    """Whether the p-value is too small, and stays so without any one of the scans."""
    from_first: bool = False
    """Whether `error` is the difference from the first scans. Otherwise, it is the difference from the calibration."""

    @property
    def off_m(self) -> float:
        """Distance of the camera from its pose by the calibration (or, `from_first`, by the first scans), metres."""
        return float(np.linalg.norm(self.error[3:]))

    @property
    def off_rad(self) -> float:
        """Rotation of the camera against that pose, radians."""
        return float(np.linalg.norm(self.error[:3]))

    @property
    def message(self) -> str:
        """The result and what to do, for the operator."""
        size = f"{self.off_m * 1000:.1f} mm and {np.degrees(self.off_rad):.2f} degrees"
        scans = f"{self.scans} scans"
        if not self.drifted and self.scans < MIN_SCANS:
            there_are = f"there {'is' if self.scans == 1 else 'are'} {self.scans or 'none'}"
            estimate = f", by which the camera is {size} off" if self.scans else ""
            return (
                f"not enough scans to tell whether the calibration has drifted: {MIN_SCANS} scans with it are needed, "
                f"and {there_are}{estimate}"
            )
        if not self.drifted and self.p_value < MAX_P_VALUE:
            return (
                f"the last {scans} do not agree with the calibration: the camera is {size} off, more than noise can "
                "explain. Without one of these scans they agree, so something may have been moved during it: scan again"
            )
        if not self.drifted:
            return f"the last {scans} agree with the calibration: the camera is {size} off, which noise explains"
        return (
            f"the calibration has drifted: by the last {scans} the camera is {size} from where "
            f"{'the first scans with this' if self.from_first else 'the hand-eye'} calibration put it, more than "
            "noise can explain: check that camera and bracket are tight, then calibrate again"
        )


def judge_drift(scans: Sequence[ScanError], covariance: NDArray[np.float64], first: Sequence[ScanError] = ()) -> Drift:
    """Test whether a calibration has drifted, with the latest scans, the first scans and the recent scans.

    Args:
        scans: Likelihoods of the scans that were made with the calibration, oldest first.
        covariance: (6, 6) covariance of the hand-eye error, radians and metres, in the order of `ScanError`.
        first: The first scans with this calibration, none of the latest among them. Empty: no such test.
    """
    latest = _test(scans[-LATEST_SCANS:], np.zeros(6), covariance)
    if latest.drifted:
        return latest
    if len(first) >= MIN_SCANS:
        # The reference is the first scans alone, whatever the calibration says.
        information = np.mean([scan.information for scan in first], axis=0) + _PRIOR_INFORMATION
        reference = np.linalg.solve(information, np.mean([scan.vector for scan in first], axis=0))
        knocked = _test(scans[-LATEST_SCANS:], reference, np.linalg.inv(information))
        if knocked.drifted:
            return replace(knocked, from_first=True)
    return _test(scans[-MAX_SCANS:], np.zeros(6), covariance)


def _test(scans: Sequence[ScanError], reference: NDArray[np.float64], covariance: NDArray[np.float64]) -> Drift:
    """Test the average error of the scans against `reference` (6,), which is known up to `covariance`."""
    informations = np.array([scan.information for scan in scans]).reshape(-1, 6, 6)
    vectors = np.array([scan.vector - scan.information @ reference for scan in scans]).reshape(-1, 6)
    p_value = _p_value(informations, vectors, covariance)
    drifted = len(scans) >= MIN_SCANS and p_value < MAX_P_VALUE
    if drifted:
        # One wrong scan, for example with something moved during it, must not raise the alarm alone.
        rest = [np.arange(len(scans)) != k for k in range(len(scans))]
        drifted = all(_p_value(informations[some], vectors[some], covariance) < MAX_P_VALUE for some in rest)
    return Drift(len(scans), _most_likely(informations, vectors), p_value, drifted)


def _p_value(informations: NDArray[np.float64], vectors: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Return the probability of an average error of at least this size without a drift."""
    if not len(informations):
        return 1.0
    from scipy.special import chdtrc

    # Whiten by the covariance of the calibration, ...
    L = np.linalg.cholesky(covariance)
    whitened = L.T @ informations @ L
    # ... and rotate to the principal axes of the information of the scans.
    total, axes = np.linalg.eigh(whitened.sum(axis=0))
    each = np.maximum(np.einsum("ia,kij,ja->ka", axes, whitened, axes), 0.0)
    enough = total > MIN_INFORMATION_SHARE
    if not enough.any():
        return 1.0
    error = (axes.T @ L.T @ vectors.sum(axis=0))[enough] / total[enough]
    # Variance of the average if the errors of all scans were fully correlated.
    variance = (np.sqrt(each[:, enough]).sum(axis=0) / each[:, enough].sum(axis=0)) ** 2
    return float(chdtrc(int(enough.sum()), float((error**2 / (1 + variance)).sum())))


def _most_likely(informations: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the most likely error (6,) by the average scan and the prior of the size of a drift."""
    count = max(len(informations), 1)
    return np.linalg.solve(informations.sum(axis=0) / count + _PRIOR_INFORMATION, vectors.sum(axis=0) / count)
