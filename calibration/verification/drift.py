"""Drift of a calibration, estimated from the scans that were made with this calibration.

Each scan gives a Gaussian likelihood of the hand-eye error (`ScanLikelihood`). The scans of a cell use the same
viewpoints, so the robot errors repeat. The errors of the scans are therefore assumed to be fully correlated. The
average of the scans is then as uncertain as a single scan.

The average is tested against the calibration, and against the first scans that were made with the calibration. The
second test detects a camera that was knocked later, even if the knock cancels an error of the calibration.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

MAX_SCANS = 20
"""Maximum number of recent scans that are tested together."""
LATEST_SCANS = 5
"""Number of latest scans that are also tested alone. Earlier scans could hide a knocked camera."""
MIN_SCANS = 3
"""Minimum number of scans for an alarm. An object may have moved during a single scan."""
MAX_P_VALUE = 0.02
"""Limit of the p-value; a smaller p-value means a drift. Registration overestimates the errors of robot and camera, so
false alarms are much rarer than this limit. None of 24 simulated cells had a p-value below 0.2."""
PRIOR_SIGMA_M = 0.005
"""Prior standard deviation of a drift per axis, metres. The prior keeps the estimate small in directions that strings
do not constrain."""
PRIOR_SIGMA_RAD = 0.0175
"""Prior standard deviation of a drift per axis, radians: about one degree."""
_PRIOR_INFORMATION = np.diag(np.repeat([PRIOR_SIGMA_RAD, PRIOR_SIGMA_M], 3) ** -2.0)
MIN_INFORMATION_SHARE = 1e-6
"""Minimum ratio of the information of the scans to the information of the reference, in each direction.

Directions with less information are ignored.
"""


@dataclass(frozen=True, eq=False)
class ScanLikelihood:
    """Gaussian likelihood of the hand-eye error `c` (6,) from one scan, without a prior.

    `c` has the order rotation (rad), then translation (m), in the camera frame:
    `T_flange_camera_true = T_flange_camera @ from_rotation_vector(translation=c[3:], rotation_vector=c[:3])`.
    """

    information: NDArray[np.float64]
    """(6, 6) information matrix (inverse covariance); may be singular."""
    vector: NDArray[np.float64]
    """(6,) information vector, `information @ c` at the maximum of the likelihood."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Result of the drift test."""

    scans: int
    """Number of scans that were tested."""
    error: NDArray[np.float64]
    """(6,) most likely hand-eye error relative to the reference, rotation (rad), then translation (m), camera frame."""
    p_value: float
    """Probability of an average error at least as large as the measured error, if no drift exists."""
    drifted: bool
    """True if the p-value is below `MAX_P_VALUE`, whichever single scan is excluded."""
    reference: Literal["calibration", "first-scans"] = "calibration"
    """Reference of `error`: the pose in the calibration, or in the first scans with this calibration."""

    @property
    def deviation_m(self) -> float:
        """Distance of the camera from its reference position, metres. `reference` names the reference."""
        return float(np.linalg.norm(self.error[3:]))

    @property
    def deviation_rad(self) -> float:
        """Rotation of the camera from its reference orientation, radians. `reference` names the reference."""
        return float(np.linalg.norm(self.error[:3]))

    @property
    def message(self) -> str:
        """Result and advice for the operator."""
        size = f"{self.deviation_m * 1000:.1f} mm and {np.degrees(self.deviation_rad):.2f} degrees"
        put_by = "the hand-eye" if self.reference == "calibration" else "the first scans with this"
        scans = f"{self.scans} scans"
        if not self.drifted and self.scans < MIN_SCANS:
            needed = (
                f"not enough scans to tell whether the calibration has drifted: {MIN_SCANS} scans with it are needed"
            )
            if self.scans == 0:
                return f"{needed}, and there are none"
            verb = "is" if self.scans == 1 else "are"
            return f"{needed}, and there {verb} {self.scans}, by which the camera is {size} off"
        if not self.drifted and self.p_value < MAX_P_VALUE:
            return (
                f"the last {scans} do not agree with the calibration: the camera is {size} off, more than noise can "
                "explain. Without one of these scans they agree, so something may have been moved during it: scan again"
            )
        if not self.drifted:
            return f"the last {scans} agree with the calibration: the camera is {size} off, which noise explains"
        return (
            f"the calibration has drifted: by the last {scans} the camera is {size} from where {put_by} calibration "
            "put it, more than noise can explain: check that camera and bracket are tight, then calibrate again"
        )


def judge_drift(
    scans: Sequence[ScanLikelihood], covariance: NDArray[np.float64], first: Sequence[ScanLikelihood] = ()
) -> Drift:
    """Test whether a calibration has drifted.

    The function makes up to three tests:

    1. the latest `LATEST_SCANS` scans against the calibration;
    2. the latest `LATEST_SCANS` scans against the first scans;
    3. the latest `MAX_SCANS` scans against the calibration.

    It returns the result of the first test that finds a drift, or else the result of the third test.

    Args:
        scans: Likelihoods from the scans that were made with the calibration, oldest first.
        covariance: (6, 6) covariance of the hand-eye error, rotation (rad), then translation (m).
        first: Likelihoods from the first scans with this calibration, without any of the latest scans. The second test
            needs at least `MIN_SCANS` first scans.
    """
    latest = _test(scans[-LATEST_SCANS:], np.zeros(6), covariance)
    if latest.drifted:
        return latest
    if len(first) >= MIN_SCANS:
        # The reference is the average of the first scans alone. The calibration has no influence.
        information = np.mean([scan.information for scan in first], axis=0) + _PRIOR_INFORMATION
        reference = np.linalg.solve(information, np.mean([scan.vector for scan in first], axis=0))
        knocked = _test(scans[-LATEST_SCANS:], reference, np.linalg.inv(information))
        if knocked.drifted:
            return replace(knocked, reference="first-scans")
    return _test(scans[-MAX_SCANS:], np.zeros(6), covariance)


def _test(scans: Sequence[ScanLikelihood], reference: NDArray[np.float64], covariance: NDArray[np.float64]) -> Drift:
    """Test the average hand-eye error of the scans against a `reference` (6,) with its `covariance` (6, 6)."""
    informations = np.array([scan.information for scan in scans]).reshape(-1, 6, 6)
    vectors = np.array([scan.vector - scan.information @ reference for scan in scans]).reshape(-1, 6)
    p_value = _p_value(informations, vectors, covariance)
    drifted = len(scans) >= MIN_SCANS and p_value < MAX_P_VALUE
    if drifted:
        # A single bad scan must not raise the alarm, for example if an object moved during the scan.
        rest = [np.arange(len(scans)) != k for k in range(len(scans))]
        drifted = all(_p_value(informations[some], vectors[some], covariance) < MAX_P_VALUE for some in rest)
    return Drift(len(scans), _most_likely(informations, vectors), p_value, drifted)


def _p_value(informations: NDArray[np.float64], vectors: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Return the p-value of the average error under the hypothesis of no drift.

    `informations` (S, 6, 6) and `vectors` (S, 6) are the likelihoods of the error relative to the reference, as in
    `ScanLikelihood`. `covariance` (6, 6) is the covariance of the reference.
    """
    if not len(informations):
        return 1.0
    from scipy.special import chdtrc

    # Whiten by the covariance of the reference.
    L = np.linalg.cholesky(covariance)
    whitened = L.T @ informations @ L
    # Rotate to the eigenvectors of the information matrix of the scans.
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
    """Return the most likely error (6,) from the average of the scans and the prior of a drift."""
    count = max(len(informations), 1)
    return np.linalg.solve(informations.sum(axis=0) / count + _PRIOR_INFORMATION, vectors.sum(axis=0) / count)
