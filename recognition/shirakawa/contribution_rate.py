"""Distinction of intersection by the contribution rate of the main axis (section III.C)."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbour_matrix
from recognition.parameters import ChainParameters


def contribution_rates(points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """(N,) share of the largest eigenvalue in the covariance of the neighbours within `radius` (eqs. 4 to 6).

    1 on a line, 1/2 on a symmetric flat cross, 1/3 in a ball. A point without neighbours has no width either:
    its rate is 1.
    """
    A = neighbour_matrix(points, points, radius)
    k = np.asarray(A.sum(axis=1))[:, None]
    # Relative to the centroid of all, so that the products below lose no digits.
    local = points - points.mean(axis=0) if len(points) else points
    q_a = (A @ local) / k
    products = (local[:, :, None] * local[:, None, :]).reshape(-1, 9)
    R = ((A @ products) / k).reshape(-1, 3, 3) - q_a[:, :, None] * q_a[:, None, :]
    eigenvalues = np.abs(np.linalg.eigvalsh(R))
    total = eigenvalues.sum(axis=1)
    alone = total <= (1e-6 * radius) ** 2
    return np.where(alone, 1.0, eigenvalues.max(axis=1) / np.where(alone, 1.0, total))


def intersection_points(
    points: NDArray[np.float64], rho: NDArray[np.float64], parameters: ChainParameters
) -> NDArray[np.bool_]:
    """(N,) which of `points` constitute an intersection: those of the neighbourhoods with rho < rho_t (III.C).

    rho is a property of the neighbourhood within r_s. Taking its centre alone would leave out the middle of an
    intersection where the over strand's points outnumber the others, and a line of no width, as clean depth
    gives, could never reach R_t: on a right-angled cross R_c would stay under 1/2.
    """
    A = neighbour_matrix(points, points, parameters.r_s)
    return A @ (rho < parameters.rho_t).astype(np.float64) > 0
