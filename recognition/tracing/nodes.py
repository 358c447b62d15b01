"""Nodes of the centre line: thinned centre points with the direction of their string."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums, neighbour_pairs
from recognition.geometry.voxel_grid import voxel_indices
from recognition.parameters import ChainParameters

VOXEL_RADII = 0.4
"""Edge of the voxels in which centre points are averaged, in radii.

The centre lines of strands on each other are at least 1.2 r apart.
"""
PCA_RADII = 1.5
"""Radius of the neighbourhood that gives the local direction, in radii.

It is less than the distance between strands on each other.
"""
ALONG_RADII = 1.6
"""Distance along the string within which neighbours count in the mean of a node, in radii."""
ACROSS_SIGMA_RADII = 0.4
"""One sigma of the weight across the string, in radii. Strands side by side are 2 r apart."""
MIN_DIRECTION_COSINE = np.cos(np.radians(40))
"""Nodes whose directions differ by more than 40 degrees are not of the same strand."""
N_PASSES = 3
"""Number of thinning passes. After them, the nodes of a strand are within a tenth of r of one line."""
MIN_RHO = 0.5
"""Minimum contribution rate of a node.

A lower rate means a surface or a clump instead of a line. Where strands are merged in the data, it is higher.
"""
MIN_SUPPORT_SHARE = 0.05
"""Nodes with less than this share of the median support are noise."""


@dataclass(frozen=True, eq=False)
class CentreLineNodes:
    """Thinned points with the direction of the string at each."""

    points: NDArray[np.float64]
    """(N, 3) points on the centre lines, metres, base frame."""
    directions: NDArray[np.float64]
    """(N, 3) unit vectors along the string. The sign has no meaning."""
    support: NDArray[np.float64]
    """(N,) number of centre points near each node, weighted by their distance."""
    rho: NDArray[np.float64]
    """(N,) contribution rate of the main axis (eq. 6), before thinning."""

    def __getitem__(self, indices: NDArray[np.bool_] | NDArray[np.int64]) -> "CentreLineNodes":
        """Return the nodes of a mask or of an array of indices."""
        return CentreLineNodes(self.points[indices], self.directions[indices], self.support[indices], self.rho[indices])


def extract_nodes(centre_points: NDArray[np.float64], parameters: ChainParameters) -> CentreLineNodes:
    """Return the nodes of the centre line.

    The centre points are averaged in voxels, and three passes of thinning follow. A neighbour counts in the mean of a
    node if it lies along the node's own string: both its offset across the string and the angle between the directions
    decide. Strands that cross, or that lie side by side, are therefore drawn to their own lines, even where they are
    merged in the data. A node moves across its string only, so that the ends are not drawn inwards.

    Args:
        centre_points: (N, 3) centre points c_i of eq. (1), metres, base frame.
        parameters: Radius r.

    Returns:
        The nodes. Points without a direction and nodes with little support are excluded.

    Source:
        Section III.B, eq. (3), with two additions of ours: the weight of the neighbours, and motion across the string
        only. The direction is the main axis of the covariance of eq. (5), and its share is the contribution rate of
        eq. (6), both section III.C.
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
    return nodes[nodes.support >= MIN_SUPPORT_SHARE * np.median(nodes.support)] if len(nodes.points) else nodes


def _thin_nodes(nodes: CentreLineNodes, weights: NDArray[np.float64], r: float) -> CentreLineNodes:
    """Move each node across its string to the mean of its neighbours, and average their directions."""
    i, j = neighbour_pairs(nodes.points, np.hypot(ALONG_RADII, 1.0) * r)
    offset = nodes.points[j] - nodes.points[i]
    along = np.vecdot(offset, nodes.directions[i])
    across = offset - along[:, None] * nodes.directions[i]
    square = np.vecdot(across, across) / r**2
    cosine = np.vecdot(nodes.directions[i], nodes.directions[j])
    is_near = (np.abs(along) < ALONG_RADII * r) & (square < 1) & (np.abs(cosine) > MIN_DIRECTION_COSINE)
    i, j, square, along = i[is_near], j[is_near], square[is_near], along[is_near]
    weight = weights[j] * np.exp(-square / (2 * ACROSS_SIGMA_RADII**2)) * (1 - (along / (ALONG_RADII * r)) ** 2)
    count = len(nodes.points)
    support = group_sums(i, weight, count)
    points = nodes.points + group_sums(i, weight[:, None] * across[is_near], count) / support[:, None]
    directions = group_sums(i, (weight * np.sign(cosine[is_near]))[:, None] * nodes.directions[j], count)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return CentreLineNodes(points, directions, support, nodes.rho)


def _merge_nodes_per_voxel(
    nodes: CentreLineNodes, weights: NDArray[np.float64], size: float
) -> tuple[CentreLineNodes, NDArray[np.float64]]:
    """Keep the best-supported node of each voxel and sum the weights of all."""
    voxel, count = voxel_indices(nodes.points, size)
    # The order is by voxel; within each voxel, the best-supported node is the last.
    best = np.lexsort((nodes.support, voxel))[np.cumsum(count) - 1]
    return nodes[best], group_sums(voxel, weights, len(count))


def _main_axes(
    points: NDArray[np.float64], weights: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (N, 3) the main axis of the weighted neighbours within `radius`, and (N,) its contribution rate."""
    i, j = neighbour_pairs(points, radius)
    offset = points[j] - points[i]
    total = group_sums(i, weights[j], len(points))[:, None]
    mean = group_sums(i, weights[j, None] * offset, len(points)) / total
    products = (weights[j, None, None] * offset[:, :, None] * offset[:, None, :]).reshape(-1, 9)
    R = (group_sums(i, products, len(points)) / total).reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    eigenvalues, axes = np.linalg.eigh(R)
    eigenvalues = np.abs(eigenvalues)
    # A node without neighbours has no direction: the lower limit makes its rate zero.
    return axes[:, :, 2], eigenvalues[:, 2] / np.maximum(eigenvalues.sum(axis=1), (1e-6 * radius) ** 2)
