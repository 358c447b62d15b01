"""Nodes of the centre line: thinned centre points with the direction of the string."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums, neighbour_pairs
from recognition.geometry.voxel_grid import voxel_indices
from recognition.parameters import ChainParameters

VOXEL_RADII = 0.4
"""Edge length of the voxels in which centre points are averaged, in radii r.

At a crossing, the two centre lines are at least 1.2 r apart.
"""
PCA_RADII = 1.5
"""Radius of the neighbourhood for the PCA that gives the local direction, in radii r."""
ALONG_RADII = 1.6
"""Maximum distance along the string between a node and its neighbours, in radii r."""
ACROSS_SIGMA_RADII = 0.4
"""Standard deviation of the Gaussian weight across the string, in radii r. Strands side by side are 2 r apart."""
MIN_DIRECTION_COSINE = np.cos(np.radians(40))
"""Minimum cosine between the directions of two nodes of the same strand (40 degrees)."""
N_PASSES = 3
"""Number of thinning passes. After three passes, the nodes of a strand are within 0.1 r of one line."""
MIN_RHO = 0.5
"""Minimum contribution rate of a node.

A lower rate means a surface or a clump instead of a line. Merged strands still have a higher rate.
"""
MIN_NODE_SUPPORT_SHARE = 0.05
"""Minimum support of a node, as a share of the median support. Nodes with less support are noise."""
ISOLATED_SHARE = 1e-6
"""Size of a neighbourhood, relative to its radius, below which its point has no neighbours."""


@dataclass(frozen=True, eq=False)
class CentreLineNodes:
    """Thinned centre points, and the direction of the string at each point."""

    points: NDArray[np.float64]
    """(N, 3) points on the centre lines, metres, base frame."""
    directions: NDArray[np.float64]
    """(N, 3) unit vectors along the string. The sign has no meaning."""
    support: NDArray[np.float64]
    """(N,) distance-weighted count of the centre points near each node."""
    rho: NDArray[np.float64]
    """(N,) contribution rate (eq. 6) of each node before thinning, `MIN_RHO` to 1."""

    def __getitem__(self, indices: NDArray[np.bool_] | NDArray[np.int64]) -> "CentreLineNodes":
        """Return the subset of the nodes for a mask or for an array of indices."""
        return CentreLineNodes(self.points[indices], self.directions[indices], self.support[indices], self.rho[indices])


def extract_nodes(centre_points: NDArray[np.float64], parameters: ChainParameters) -> CentreLineNodes:
    """Extract the nodes of the centre line from the centre points.

    The centre points are averaged in voxels. Three thinning passes then move each node to the weighted mean of its
    neighbours. The weight of a neighbour falls with its distance from the node. The weight is zero if the directions of
    the two nodes differ by more than 40 degrees. This keeps crossing or adjacent strands apart, even where their points
    merge. Nodes move only perpendicular to the string, so that the ends do not shrink.

    Args:
        centre_points: (N, 3) centre points c_i of eq. (1), metres, base frame.
        parameters: Method parameters; uses the radius r.

    Returns:
        The nodes. Points with a low contribution rate and nodes with little support are excluded.

    Source:
        Section III.B, eq. (3), for the thinning. The weights and the motion across the string are not in the paper.
        Section III.C, eqs. (5) and (6), for the direction (first eigenvector of the covariance) and the contribution
        rate.
    """
    r = parameters.r
    voxel, count = voxel_indices(centre_points, VOXEL_RADII * r)
    weights = count.astype(np.float64)
    points = group_sums(voxel, centre_points, len(count)) / weights[:, None]
    directions, rho = _main_axes(points, weights, PCA_RADII * r)
    is_linear = rho >= MIN_RHO
    nodes = CentreLineNodes(points[is_linear], directions[is_linear], weights[is_linear], rho[is_linear])
    weights = weights[is_linear]
    for _ in range(N_PASSES):
        nodes = _thin_nodes(nodes, weights, r)
        # Nodes that moved into the same voxel become one node.
        nodes, weights = _merge_nodes_per_voxel(nodes, weights, VOXEL_RADII * r)
    if len(nodes.points) == 0:
        return nodes
    return nodes[nodes.support >= MIN_NODE_SUPPORT_SHARE * np.median(nodes.support)]


def _thin_nodes(nodes: CentreLineNodes, weights: NDArray[np.float64], r: float) -> CentreLineNodes:
    """Move each node across the string to the weighted mean of its neighbours, and average the directions.

    `weights` (N,) are the numbers of centre points that the nodes represent.
    """
    i, j = neighbour_pairs(nodes.points, np.hypot(ALONG_RADII, 1.0) * r)
    # Each coordinate is one row: numpy is several times faster on three long rows than on rows of three.
    points = nodes.points.T
    axes = nodes.directions.T
    offset = points.take(j, axis=1) - points.take(i, axis=1)
    direction = axes.take(i, axis=1)
    other_direction = axes.take(j, axis=1)
    along = np.einsum("ij,ij->j", offset, direction)
    across = offset - along * direction
    square = np.einsum("ij,ij->j", across, across) / r**2
    cosine = np.einsum("ij,ij->j", direction, other_direction)
    is_near = (np.abs(along) < ALONG_RADII * r) & (square < 1) & (np.abs(cosine) > MIN_DIRECTION_COSINE)
    near = np.flatnonzero(is_near)
    i = i[near]
    weight_across = np.exp(-square[near] / (2 * ACROSS_SIGMA_RADII**2))
    weight_along = 1 - (along[near] / (ALONG_RADII * r)) ** 2
    weight = weights[j[near]] * weight_across * weight_along
    count = len(nodes.points)
    support = group_sums(i, weight, count)
    moved = nodes.points + group_sums(i, (weight * across.take(near, axis=1)).T, count) / support[:, None]
    aligned = np.sign(cosine[near]) * other_direction.take(near, axis=1)
    directions = group_sums(i, (weight * aligned).T, count)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return CentreLineNodes(moved, directions, support, nodes.rho)


def _merge_nodes_per_voxel(
    nodes: CentreLineNodes, weights: NDArray[np.float64], size: float
) -> tuple[CentreLineNodes, NDArray[np.float64]]:
    """Keep the best-supported node of each voxel and sum the weights of all its nodes. `size` is in metres."""
    voxel, count = voxel_indices(nodes.points, size)
    # Sort by voxel, then by support. The last node of each voxel is the best-supported node.
    best = np.lexsort((nodes.support, voxel))[np.cumsum(count) - 1]
    return nodes[best], group_sums(voxel, weights, len(count))


def _main_axes(
    points: NDArray[np.float64], weights: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the local direction (N, 3) and the contribution rate (N,) of each point.

    The direction is the eigenvector of the largest eigenvalue of the weighted covariance of the neighbours within
    `radius`, metres.
    """
    i, j = neighbour_pairs(points, radius)
    offset = points.T.take(j, axis=1) - points.T.take(i, axis=1)
    total = group_sums(i, weights[j], len(points))[:, None]
    mean = group_sums(i, (weights[j] * offset).T, len(points)) / total
    # The matrices are symmetric: six products of the coordinates are enough.
    x, y, z = offset
    products = weights[j] * np.array([x * x, x * y, x * z, y * y, y * z, z * z])
    second = group_sums(i, products.T, len(points)) / total
    covariance = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    eigenvalues, axes = np.linalg.eigh(covariance)
    eigenvalues = np.abs(eigenvalues)
    # The lower limit of the denominator gives a point without neighbours the rate zero.
    sums = np.maximum(eigenvalues.sum(axis=1), (ISOLATED_SHARE * radius) ** 2)
    return axes[:, :, 2], eigenvalues[:, 2] / sums
