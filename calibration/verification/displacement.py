"""Where a board is that does not appear where it lay, and whether its own motion or the camera's explains that better.

A board on a table is shifted along the table and turned about its normal, alike for all views. One that is seen by a
camera that was moved appears elsewhere along that camera's axes, and so in other directions from another side.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.verification.board_prediction import BoardObservation, PredictedBoard


@dataclass(frozen=True, eq=False)
class Displacement:
    """Of N views together: how far from where it lay, a rotation vector and a shift of its middle each, as in
    `calibration.verification.board_prediction.BoardObservation`."""

    off: NDArray[np.float64]
    """(6,) their mean."""
    covariance: NDArray[np.float64]
    """(6, 6) of that."""
    apart: NDArray[np.float64]
    """(P, 6) how far each pair of views has it from one another ..."""
    apart_covariances: NDArray[np.float64]
    """(P, 6, 6) ... and the covariances of that."""
    by_camera: NDArray[np.float64]
    """(N, 6) where the views would have it by that motion of the camera which explains them best ..."""
    camera_squares: float
    """... and the squares in standard deviations that it explains: those of six numbers."""
    board_likelier: float
    """Squares in standard deviations that are left where it is the camera that was moved, less those that are left
    where it is the board: twice the logarithm of by how much likelier the board is."""


def locate_displacement(claim: PredictedBoard, seen: Sequence[BoardObservation]) -> Displacement:
    """Where the views (one or more) put the board together."""
    from scipy.linalg import block_diag

    normal = claim.Y[:3, 2]
    off, by_claim = _from_the_first(claim, seen)
    own = np.asarray(block_diag(*(each.own for each in seen)))
    covariance = own + by_claim @ claim.covariance @ by_claim.T
    count = len(seen)
    mean = np.tile(np.eye(6) / count, count)
    one, other = np.triu_indices(count, 1)
    places, between = off.reshape(-1, 6), covariance.reshape(count, 6, count, 6)
    by_camera, left_by_camera = _best(off, by_claim[:, :6], covariance)
    board = np.zeros((6, 3))
    board[:3, 0], board[3:, 1:] = normal, claim.Y[:3, :2]
    return Displacement(
        off=mean @ off,
        covariance=mean @ covariance @ mean.T,
        apart=places[one] - places[other],
        apart_covariances=(
            between[one, :, one] + between[other, :, other] - between[one, :, other] - between[other, :, one]
        ),
        by_camera=by_camera.reshape(-1, 6),
        camera_squares=float(off @ np.linalg.solve(covariance, off)) - left_by_camera,
        board_likelier=left_by_camera - _best(off, np.tile(board, (count, 1)), covariance)[1],
    )


def _from_the_first(
    claim: PredictedBoard, seen: Sequence[BoardObservation]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(6N,) and (6N, C) where the views have the board and how that depends on the claim. Rotation vectors of large
    turns do not add up: they are taken from that turn about the normal by which the first view has it turned."""
    from scipy.spatial.transform import Rotation

    normal = claim.Y[:3, 2]
    x, y, z, w = Rotation.from_rotvec(seen[0].off[:3]).as_quat()
    twist = 2 * float(np.arctan2(normal @ [x, y, z], w)) * normal
    turned = Rotation.from_rotvec(twist)
    off, by_claim = [], []
    for each in seen:
        rest = (Rotation.from_rotvec(each.off[:3]) * turned.inv()).as_rotvec()
        off.append(np.concatenate([twist + rest, each.off[3:]]))
        changes = each.by_claim.copy()
        # What it was thought to be tilted by turned with it.
        changes[:3, 6:12] = turned.as_matrix() @ changes[:3, 6:12]
        by_claim.append(changes)
    return np.concatenate(off), np.concatenate(by_claim)


def _best(
    off: NDArray[np.float64], changes: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """(D,) the best of `changes` (D, U) for `off` (D,), and the squares, in standard deviations, that it leaves."""
    from scipy.linalg import solve_triangular

    L = np.linalg.cholesky(covariance)
    whitened, aim = solve_triangular(L, changes, lower=True), solve_triangular(L, off, lower=True)
    best = np.linalg.lstsq(whitened, aim, rcond=None)[0]
    return changes @ best, float(np.sum((aim - whitened @ best) ** 2))
