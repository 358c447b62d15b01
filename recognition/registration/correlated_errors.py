"""Covariance of the registered poses if views at similar poses have similar robot errors.

The alignment assumes that the robot errors of the views are independent. Those of a real arm mostly change smoothly
with the pose, so that the mean over the views has a larger error. The surfaces show the differences between the views,
and these decide how much of the error is smooth: smooth errors of neighbouring views are more similar than those of
distant views. They also show errors that are larger in total than the given standard deviations.
"""

from collections.abc import Sequence

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
        state: (6 V + 7,) aligned state, computed with independent robot errors.
        information: (6 V + 7, 6 V + 7) information matrix of the state.
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
    without_robot, vector = information - D.T @ D, information @ state + D.T @ d
    sizes = np.array(SIZES)
    log_evidence, candidates = np.zeros((len(SMOOTH_SHARES), len(sizes))), []
    for i, share in enumerate(SMOOTH_SHARES):
        views = (1 - share) * np.eye(len(known)) + share * correlation
        robot = np.kron(np.linalg.inv(views), np.eye(6))
        prior_information, prior_vector, squares = D.T @ robot @ D, D.T @ (robot @ d), d @ robot @ d
        log_views = 6 * np.linalg.slogdet(views)[1]
        for k, size in enumerate(sizes):
            root = cholesky(without_robot + prior_information / size**2, lower=True)
            b = vector - prior_vector / size**2
            mean = cho_solve((root, True), b)
            log_determinants = log_views + 12 * len(known) * np.log(size) + 2 * np.log(np.diag(root)).sum()
            log_evidence[i, k] = (b @ mean - squares / size**2 - log_determinants) / 2 - np.log(size)
            candidates.append((root, mean))
    weights = np.exp(log_evidence - log_evidence.max())
    if (weights @ sizes**2).sum() < weights.sum():  # the mean variance is less than the given one
        weights = np.where(sizes == 1.0, np.exp(log_evidence - log_evidence[:, sizes == 1.0].max()), 0.0)
    weights /= weights.sum()
    covariance = np.zeros_like(information)
    for weight, (root, mean) in zip(weights.ravel(), candidates, strict=True):
        if weight > MIN_WEIGHT:
            change = mean - state
            covariance += weight * (cho_solve((root, True), np.eye(len(root))) + np.outer(change, change))
    return np.asarray(covariance[:-N_SHARED, :-N_SHARED], dtype=np.float64)
