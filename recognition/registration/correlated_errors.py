"""Covariance of the registered poses if views at similar poses have similar robot errors.

The alignment assumes that the robot errors of the views are independent. Those of a real arm mostly change smoothly
with the pose, so that the mean over the views has a larger error. The surfaces show the differences between the views,
and these decide how much of the error is smooth: smooth errors of neighbouring views are more similar than those of
distant views.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.pose_correlation import pose_correlation
from recognition.registration.pose_prior import N_SHARED, PosePrior

SMOOTH_SHARES = (0.0, 0.3, 0.6, 0.9)
"""Shares of the variance of the robot errors that change smoothly with the pose. Without a scan, all are equally
probable. The rest is independent in each view: even an accurate arm has a repeatability."""


def pose_covariance(
    state: NDArray[np.float64],
    information: NDArray[np.float64],
    prior: PosePrior,
    T_base_camera: Sequence[NDArray[np.float64] | None],
) -> NDArray[np.float64]:
    """Return the covariance of the errors of the aligned poses, averaged over the shares of smooth robot errors.

    For each share, the prior of the robot errors is exchanged in the normal equations of the alignment. The weight of
    the share is the probability of the measured surfaces. The poses stay as they are, so their distance from the poses
    of the share is part of their error.

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
    log_evidence, covariances = [], []
    for share in SMOOTH_SHARES:
        views = (1 - share) * np.eye(len(known)) + share * correlation
        robot = np.kron(np.linalg.inv(views), np.eye(6))
        H, b = without_robot + D.T @ robot @ D, vector - D.T @ (robot @ d)
        covariance = np.linalg.inv(H)
        mean = covariance @ b
        log_determinants = 6 * np.linalg.slogdet(views)[1] + np.linalg.slogdet(H)[1]
        log_evidence.append((b @ mean - d @ robot @ d - log_determinants) / 2)
        change = mean - state
        covariances.append((covariance + np.outer(change, change))[:-N_SHARED, :-N_SHARED])
    weights = np.exp(np.array(log_evidence) - max(log_evidence))
    return np.asarray(np.average(covariances, axis=0, weights=weights), dtype=np.float64)
