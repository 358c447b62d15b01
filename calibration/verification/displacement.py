"""Explanation of a displaced board by a motion of the board or by a motion of the camera.

A board on a table moves along the table and turns about its normal, by the same amount in all views. A moved camera
displaces the board in the axes of the camera. The displacement then differs between viewpoints.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.verification.board_prediction import BoardObservation, PredictedBoard


@dataclass(frozen=True, eq=False)
class Displacement:
    """Displacement of the board, estimated from N views.

    Deviations have the axes, order and units of `BoardObservation.deviation`.
    """

    mean: NDArray[np.float64]
    """(6,) mean deviation over the views."""
    covariance: NDArray[np.float64]
    """(6, 6) covariance of `mean`."""
    pair_differences: NDArray[np.float64]
    """(P, 6) difference between the deviations of the two views of each pair."""
    pair_covariances: NDArray[np.float64]
    """(P, 6, 6) covariance of each pair difference."""
    camera_deviations: NDArray[np.float64]
    """(N, 6) deviations that the best-fitting camera motion predicts."""
    camera_chi2: float
    """Reduction of chi-square by the best-fitting camera motion, which has six parameters."""
    board_log_ratio: float
    """Twice the log-likelihood ratio of a moved board to a moved camera; positive if a moved board is more likely."""


def estimate_displacement(predicted: PredictedBoard, observations: Sequence[BoardObservation]) -> Displacement:
    """Combine the observations of one or more views into one displacement of the board.

    Args:
        predicted: Board pose predicted by the calibration.
        observations: Deviations of the N views from the prediction, at least one.
    """
    from scipy.linalg import block_diag

    normal = predicted.Y[:3, 2]
    deviations, J_prediction = _averageable_deviations(predicted, observations)
    own = np.asarray(block_diag(*(each.own_covariance for each in observations)))
    covariance = own + J_prediction @ predicted.covariance @ J_prediction.T
    count = len(observations)
    mean = np.tile(np.eye(6) / count, count)
    one, other = np.triu_indices(count, 1)
    per_view = deviations.reshape(-1, 6)
    between = covariance.reshape(count, 6, count, 6)
    camera_deviations, camera_residual = _best_explanation(deviations, J_prediction[:, :6], covariance)
    J_board = np.zeros((6, 3))
    J_board[:3, 0] = normal
    J_board[3:, 1:] = predicted.Y[:3, :2]
    _, board_residual = _best_explanation(deviations, np.tile(J_board, (count, 1)), covariance)
    return Displacement(
        mean=mean @ deviations,
        covariance=mean @ covariance @ mean.T,
        pair_differences=per_view[one] - per_view[other],
        pair_covariances=(
            between[one, :, one] + between[other, :, other] - between[one, :, other] - between[other, :, one]
        ),
        camera_deviations=camera_deviations.reshape(-1, 6),
        camera_chi2=float(deviations @ np.linalg.solve(covariance, deviations)) - camera_residual,
        board_log_ratio=camera_residual - board_residual,
    )


def _averageable_deviations(
    predicted: PredictedBoard, observations: Sequence[BoardObservation]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return deviations (6N,) that can be averaged, and their Jacobian (6N, C) with respect to the prediction errors.

    Rotation vectors of large rotations cannot be averaged. Each rotation is therefore split into two parts: the turn of
    the first view about the board normal, and a small remainder. The returned rotation is the sum of both vectors.
    """
    from scipy.spatial.transform import Rotation

    normal = predicted.Y[:3, 2]
    x, y, z, w = Rotation.from_rotvec(observations[0].deviation[:3]).as_quat()
    twist = 2 * float(np.arctan2(normal @ [x, y, z], w)) * normal
    turned = Rotation.from_rotvec(twist)
    deviations = []
    jacobians = []
    for each in observations:
        rest = (Rotation.from_rotvec(each.deviation[:3]) * turned.inv()).as_rotvec()
        deviations.append(np.concatenate([twist + rest, each.deviation[3:]]))
        J = each.J_prediction.copy()
        # An error of the predicted board pose turns together with the board.
        J[:3, 6:12] = turned.as_matrix() @ J[:3, 6:12]
        jacobians.append(J)
    return np.concatenate(deviations), np.concatenate(jacobians)


def _best_explanation(
    deviations: NDArray[np.float64], J: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Fit the columns of `J` (D, U) to `deviations` (D,), and return the fit (D,) and the remaining chi-square.

    `covariance` (D, D) is the covariance of the deviations.
    """
    from scipy.linalg import solve_triangular

    L = np.linalg.cholesky(covariance)
    A = solve_triangular(L, J, lower=True)
    b = solve_triangular(L, deviations, lower=True)
    x = np.linalg.lstsq(A, b, rcond=None)[0]
    return J @ x, float(np.sum((b - A @ x) ** 2))
