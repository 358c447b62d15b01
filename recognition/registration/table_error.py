"""How wrong the given table plane may be, if the views neither confirm it nor show that it is elsewhere.

The views show the plane only to within the errors of their poses, so the given plane is used as long as these errors
explain the difference. But a table height from a tape measure explains it as well. A mixture of two hypotheses weighs
both: the given plane is exact, or it is some millimetres or tenths of a degree off.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from recognition.registration.measured_table import MeasuredTable
from recognition.registration.pose_prior import PoseSigmas, given_pose_covariance
from recognition.registration.registration import Registration

WRONG_SHARE = 0.03
"""Assumed share of scans whose given plane is off, by height or by tilt. It decides how large a difference must be to
count: at 0.03, the hypotheses are equally probable for a height that differs by about 3 sigma of the pose errors."""
WRONG_HEIGHT_M = 0.002
"""Assumed error of a height that is off, metres, one sigma."""
WRONG_TILT_RAD = float(np.deg2rad(0.5))
"""Assumed tilt about each axis of a plane that is off, radians, one sigma."""


@dataclass(frozen=True, eq=False)
class TableErrorEstimate:
    """Error that the given plane may have, as the views show it."""

    covariance: NDArray[np.float64]
    """(3, 3) expected square of the error: rotation about x and y (rad), and height at the centre of the table (m)."""
    probability: float
    """Probability that the given plane is off, by height or by tilt; the larger of the two."""


def estimate_table_error(table: MeasuredTable) -> TableErrorEstimate:
    """Return the error that the given plane may have, from the plane that the views show.

    Height and tilt are judged separately. Both hypotheses are Gaussian: the measured offset has the covariance of the
    pose errors, or that covariance plus the one of a plane that is off.
    """
    tilt = _estimate_part(table.offset[:2], table.covariance[:2, :2], WRONG_TILT_RAD)
    height = _estimate_part(table.offset[2:], table.covariance[2:, 2:], WRONG_HEIGHT_M)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = tilt.covariance
    covariance[2:, 2:] = height.covariance
    return TableErrorEstimate(covariance, max(height.probability, tilt.probability))


def _estimate_part(offset: NDArray[np.float64], exact: NDArray[np.float64], wrong_sigma: float) -> TableErrorEstimate:
    """Return the error that a part (N,) of the given plane may have.

    `exact` (N, N) is the covariance of the measured offset if the given plane is exact, and `wrong_sigma` the standard
    deviation of an error of a plane that is off.
    """
    prior = np.eye(len(offset)) * wrong_sigma**2
    log_odds = _log_density(offset, exact + prior) - _log_density(offset, exact)
    probability = float(expit(log_odds + np.log(WRONG_SHARE / (1 - WRONG_SHARE))))
    gain = prior @ np.linalg.inv(exact + prior)
    error = gain @ offset
    covariance = probability * (prior - gain @ prior + np.outer(error, error))
    return TableErrorEstimate(covariance, probability)


def add_table_error(
    registration: Registration, table: MeasuredTable | None, sigmas: PoseSigmas | None = None
) -> Registration:
    """Return the registration with the error of the table to which the views were aligned.

    The poses of all views have this error. If the table is not where it is given, the views were aligned to the
    measured one. They then do not show the hand-eye error, because this table was computed from the same views, and a
    single view has the whole error of its given pose.

    Args:
        registration: Registered views.
        table: Where the views show the table. None, if no view shows it, returns the registration as it is.
        sigmas: Standard deviations of the pose errors. None: the defaults of `PoseSigmas`.
    """
    if table is None:
        return registration
    if table.is_elsewhere:
        error = table.covariance
        registration = replace(registration, hand_eye_error=None)
        if len(registration.clouds) == 1:
            covariance = given_pose_covariance(registration.clouds[0], registration.centre, sigmas or PoseSigmas())
            return replace(registration, covariance=covariance)
    else:
        error = estimate_table_error(table).covariance
    n = len(registration.clouds)
    common = np.tile(table.pose_covariance(error, registration.centre), (n, n))
    return replace(registration, covariance=registration.covariance + common)


def _log_density(offset: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Return the logarithm of a centred Gaussian density at an offset, without the constant."""
    return float(-0.5 * (offset @ np.linalg.solve(covariance, offset) + np.linalg.slogdet(covariance)[1]))
