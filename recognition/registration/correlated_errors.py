"""Covariance of the registered poses if views at similar poses have similar robot errors.

The alignment assumes that the robot errors of the views are independent. Those of a real arm mostly change smoothly
with the pose, so that the mean over the views has a larger error. The surfaces show the differences between the views,
and these decide how much of the error is smooth: smooth errors of neighbouring views are more similar than those of
distant views. They also show errors that are larger in total than the given standard deviations.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from calibration.geometry.pose_correlation import pose_correlation
from recognition.registration.pose_prior import N_SHARED, PosePrior

SMOOTH_SHARES = (0.0, 0.3, 0.6, 0.9)
"""Shares of the variance of the robot errors that change smoothly with the pose. Without a scan, all are equally
probable. The rest is independent in each view: even an accurate arm has a repeatability."""
SIZES = (0.5, 1.0, 2.0)
"""Sizes of the robot errors, as multiples of the given standard deviations. Before a scan, the probability of a size is
proportional to 1 / size, so that the mean variance is the given one."""
MIN_WEIGHT = 1e-3
"""Weight below which a combination of a size and a share is left out."""


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Gaussian posterior of the state for one combination of a share and a size of the robot errors."""

    root: NDArray[np.float64]
    """(6 V + 9, 6 V + 9) lower Cholesky factor of the information matrix."""
    mean: NDArray[np.float64]
    """(6 V + 9,) state with the highest probability."""
    log_evidence: float
    """Logarithm of the probability of the combination and the measured surfaces, without a constant."""

    def covariance_about(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the expected square (6 V + 9, 6 V + 9) of the difference to a state (6 V + 9,)."""
        change = self.mean - state
        return cho_solve((self.root, True), np.eye(len(self.root))) + np.outer(change, change)


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Normal equations of the alignment without the prior of the robot errors, which are `D @ state + d`."""

    information: NDArray[np.float64]
    """(6 V + 9, 6 V + 9) information matrix."""
    vector: NDArray[np.float64]
    """(6 V + 9,) information vector."""
    D: NDArray[np.float64]
    """(6 V, 6 V + 9) derivative of the robot errors by the state, in sigmas."""
    d: NDArray[np.float64]
    """(6 V,) robot errors at the zero state, in sigmas."""

    def posteriors(self, between_views: NDArray[np.float64]) -> list[_Posterior]:
        """Return the posterior for each of `SIZES` if the robot errors have the correlation (V, V) between views."""
        robot = np.kron(np.linalg.inv(between_views), np.eye(6))
        prior_information = self.D.T @ robot @ self.D
        prior_vector = self.D.T @ (robot @ self.d)
        prior_squares = self.d @ robot @ self.d
        log_views = 6 * np.linalg.slogdet(between_views)[1]
        found = []
        for size in SIZES:
            root = cholesky(self.information + prior_information / size**2, lower=True)
            vector = self.vector - prior_vector / size**2
            mean = cho_solve((root, True), vector)
            log_determinants = log_views + 2 * len(self.d) * np.log(size) + 2 * np.log(np.diag(root)).sum()
            log_likelihood = (vector @ mean - prior_squares / size**2 - log_determinants) / 2
            found.append(_Posterior(root, mean, float(log_likelihood - np.log(size))))
        return found


def pose_covariance(
    state: NDArray[np.float64],
    information: NDArray[np.float64],
    prior: PosePrior,
    T_base_camera: Sequence[NDArray[np.float64] | None],
) -> NDArray[np.float64]:
    """Return the covariance of the errors of the aligned poses, averaged over shares and sizes of robot errors.

    For each share of smooth errors and each size, the prior of the robot errors is exchanged in the normal equations of
    the alignment. The weight is the probability of the measured surfaces. The poses stay as they are, so their distance
    from the poses of the share and size is part of their error.

    If the surfaces show errors that are smaller than given, their size is the given one: surfaces with little structure
    hardly show differences between the views.

    Args:
        state: (6 V + 9,) aligned state, computed with independent robot errors.
        information: (6 V + 9, 6 V + 9) information matrix of the state.
        prior: Prior of the state.
        T_base_camera: Camera pose (4, 4) of each view; None if unknown.

    Returns:
        Covariance (6 V, 6 V) of the twists of the views. If a camera pose is unknown, the robot errors are independent.

    Source:
        The model of the smooth errors is `calibration.geometry.pose_correlation`, as in the hand-eye calibration.
        Hoeting et al., "Bayesian model averaging: a tutorial" (1999), equations 1 to 3.
    """
    known = [T for T in T_base_camera if T is not None]
    if len(known) < len(T_base_camera):
        return np.asarray(np.linalg.inv(information)[:-N_SHARED, :-N_SHARED], dtype=np.float64)
    D = np.vstack([D for D, _ in prior.robot_errors])
    d = np.concatenate([d for _, d in prior.robot_errors])
    correlation = pose_correlation(np.array(known))
    equations = _NormalEquations(information - D.T @ D, information @ state + D.T @ d, D, d)
    posteriors = []
    for share in SMOOTH_SHARES:
        between_views = (1 - share) * np.eye(len(known)) + share * correlation
        posteriors += equations.posteriors(between_views)
    log_evidence = np.array([posterior.log_evidence for posterior in posteriors])
    weights = _weights(log_evidence.reshape(len(SMOOTH_SHARES), len(SIZES)))
    covariance = np.zeros_like(information)
    for weight, posterior in zip(weights.ravel(), posteriors, strict=True):
        if weight > MIN_WEIGHT:
            covariance += weight * posterior.covariance_about(state)
    return np.asarray(covariance[:-N_SHARED, :-N_SHARED], dtype=np.float64)


def _weights(log_evidence: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights of the combinations of `SMOOTH_SHARES` (rows) and `SIZES` (columns); their sum is 1."""
    sizes = np.array(SIZES)
    weights = np.exp(log_evidence - log_evidence.max())
    is_less_than_given = (weights @ sizes**2).sum() < weights.sum()
    if is_less_than_given:
        is_given = sizes == 1.0
        weights = np.where(is_given, np.exp(log_evidence - log_evidence[:, is_given].max()), 0.0)
    return weights / weights.sum()
