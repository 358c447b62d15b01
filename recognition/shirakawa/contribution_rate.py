"""Contribution rate (section III.C), which is low at intersections and high on single strands.

Other libraries call this eigenvalue ratio PCA1 (CloudCompare) or explained variance ratio (scikit-learn).
"""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbour_matrix
from recognition.parameters import ChainParameters

ISOLATED_SHARE = 1e-6
"""Size of a neighbourhood, relative to its radius, below which its point has no neighbours."""


def contribution_rates(points: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Return the share of the largest eigenvalue in the covariance of each point's neighbours.

    The rate is 1 on a line, 1/2 in a symmetric flat cross, and 1/3 in a ball. A point without neighbours has rate 1.

    Args:
        points: (N, 3) thinned points, metres.
        radius: Radius r_s of the neighbourhoods, metres.

    Returns:
        (N,) rho, from 1/3 to 1.

    Source:
        Section III.C, eqs. (4) to (6).
    """
    if len(points) == 0:
        return np.empty(0)
    A = neighbour_matrix(points, points, radius)
    k = np.asarray(A.sum(axis=1))[:, None]
    # Relative to the centroid of all points, so that the products below lose no digits.
    local = points - points.mean(axis=0)
    q_a = (A @ local) / k
    products = (local[:, :, None] * local[:, None, :]).reshape(-1, 9)
    R = ((A @ products) / k).reshape(-1, 3, 3) - q_a[:, :, None] * q_a[:, None, :]
    eigenvalues = np.abs(np.linalg.eigvalsh(R))
    total = eigenvalues.sum(axis=1)
    isolated = total <= (ISOLATED_SHARE * radius) ** 2
    return np.where(isolated, 1.0, eigenvalues.max(axis=1) / np.where(isolated, 1.0, total))


def intersection_points(
    points: NDArray[np.float64], rho: NDArray[np.float64], parameters: ChainParameters
) -> NDArray[np.bool_]:
    """Return which points belong to an intersection.

    A point belongs to an intersection if the point or a neighbour within r_s has rho < rho_t.

    Args:
        points: (N, 3) thinned points, metres.
        rho: (N,) contribution rate of each point.
        parameters: Method parameters; uses the radius r_s and the threshold rho_t.

    Returns:
        Mask (N,), True for the points of an intersection.

    Source:
        Section III.C. The paper takes only the points with rho < rho_t. Here their neighbours are added, because rho
        describes the neighbourhood and not the point. Without the neighbours, an intersection has a hole in the middle
        if most points there lie on the over strand. Clean depth gives thin lines. Without the neighbours, R_c stays
        below 1/2 at a right-angled crossing of thin lines, and never reaches R_t.
    """
    A = neighbour_matrix(points, points, parameters.r_s)
    return A @ (rho < parameters.rho_t).astype(np.float64) > 0
