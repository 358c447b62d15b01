"""The centre line cloud thinned to nodes that know their string's direction: what the graph of strands is built of."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import group_sums, neighbour_pairs
from recognition.geometry.voxel_grid import voxel_indices
from recognition.parameters import ChainParameters

VOXEL_SHARE = 0.4
"""Centre points are averaged in voxels of this share of r first; strands on one another are at least 1.2 r apart."""
PCA_SHARE = 1.5
"""Neighbourhood of the local direction, as a share of r: less than the distance of two strands on one another."""
ALONG_SHARE = 1.6
"""How far along the string a node's mean reaches, as a share of r."""
ACROSS_SHARE = 0.4
"""One sigma of the weight across the string, as a share of r. Strands side by side are 2 r apart."""
SAME_DIRECTION = np.cos(np.radians(40))
"""Nodes whose directions differ by more are not of the same strand."""
PASSES = 3
"""Passes of thinning; the nodes of a strand are then within a tenth of r of one line."""
MIN_RHO = 0.5
"""A smaller contribution rate means a surface or a heap, not a line; where strands melt together it is above."""
MIN_SUPPORT = 0.05
"""Nodes with less than this share of the usual support are noise."""


@dataclass(frozen=True, eq=False)
class CentreLineNodes:
    """Thinned points with the direction of the string through each."""

    points: NDArray[np.float64]
    """(N, 3), on the lines' ridges."""
    directions: NDArray[np.float64]
    """(N, 3), unit length; which of the two senses is of no meaning."""
    support: NDArray[np.float64]
    """(N,), how many centre points stand behind each, weighted by nearness."""
    rho: NDArray[np.float64]
    """(N,), contribution rate of the main axis (eq. 6) before thinning."""

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> "CentreLineNodes":
        return CentreLineNodes(self.points[chosen], self.directions[chosen], self.support[chosen], self.rho[chosen])


def extract_nodes(single: NDArray[np.float64], parameters: ChainParameters) -> CentreLineNodes:
    """Nodes of the centre line under the centre points c_i (`single`, (N, 3), eq. 1).

    Thinning (eq. 3) with two additions. The mean is taken over the neighbours that lie along the node's own string:
    their offset across it and the angle between the directions both count. So two strands that cross, or lie side
    by side, are each drawn to its own line, even where they melt together. And the node moves across its string
    only, so that the ends are not drawn inwards.

    The direction is the main axis of the covariance (eq. 5), whose share is the contribution rate (eq. 6).
    """
    r = parameters.r
    voxel, count = voxel_indices(single, VOXEL_SHARE * r)
    weights = count.astype(np.float64)
    points = group_sums(voxel, single, len(count)) / weights[:, None]
    directions, rho = _main_axes(points, weights, PCA_SHARE * r)
    linear = rho >= MIN_RHO
    nodes = CentreLineNodes(points[linear], directions[linear], weights[linear], rho[linear])
    weights = weights[linear]
    for _ in range(PASSES):
        nodes = _drawn_together(nodes, weights, r)
        # Nodes that have come to lie in one voxel are one from here on.
        nodes, weights = _unified(nodes, weights, VOXEL_SHARE * r)
    return nodes[nodes.support >= MIN_SUPPORT * np.median(nodes.support)] if len(nodes.points) else nodes


def _drawn_together(nodes: CentreLineNodes, weights: NDArray[np.float64], r: float) -> CentreLineNodes:
    """Each node moved across its string to the mean of those along it; its direction the mean of theirs."""
    i, j = neighbour_pairs(nodes.points, np.hypot(ALONG_SHARE, 1.0) * r)
    offset = nodes.points[j] - nodes.points[i]
    along = np.vecdot(offset, nodes.directions[i])
    across = offset - along[:, None] * nodes.directions[i]
    square = np.vecdot(across, across) / r**2
    cosine = np.vecdot(nodes.directions[i], nodes.directions[j])
    near = (np.abs(along) < ALONG_SHARE * r) & (square < 1) & (np.abs(cosine) > SAME_DIRECTION)
    i, j, square, along = i[near], j[near], square[near], along[near]
    weight = weights[j] * np.exp(-square / (2 * ACROSS_SHARE**2)) * (1 - (along / (ALONG_SHARE * r)) ** 2)
    count = len(nodes.points)
    support = group_sums(i, weight, count)
    points = nodes.points + group_sums(i, weight[:, None] * across[near], count) / support[:, None]
    directions = group_sums(i, (weight * np.sign(cosine[near]))[:, None] * nodes.directions[j], count)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return CentreLineNodes(points, directions, support, nodes.rho)


def _unified(
    nodes: CentreLineNodes, weights: NDArray[np.float64], size: float
) -> tuple[CentreLineNodes, NDArray[np.float64]]:
    """One node a voxel: at the place and in the direction of its best borne one, with the weight of all."""
    voxel, count = voxel_indices(nodes.points, size)
    # In order of voxel, the best borne of each last.
    best = np.lexsort((nodes.support, voxel))[np.cumsum(count) - 1]
    return nodes[best], group_sums(voxel, weights, len(count))


def _main_axes(
    points: NDArray[np.float64], weights: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(N, 3) main axis of the weighted neighbours within `radius` of each point, and (N,) its contribution rate."""
    i, j = neighbour_pairs(points, radius)
    offset = points[j] - points[i]
    total = group_sums(i, weights[j], len(points))[:, None]
    mean = group_sums(i, weights[j, None] * offset, len(points)) / total
    products = (weights[j, None, None] * offset[:, :, None] * offset[:, None, :]).reshape(-1, 9)
    R = (group_sums(i, products, len(points)) / total).reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    eigenvalues, axes = np.linalg.eigh(R)
    eigenvalues = np.abs(eigenvalues)
    # A node without neighbours shows no line.
    return axes[:, :, 2], eigenvalues[:, 2] / np.maximum(eigenvalues.sum(axis=1), (1e-6 * radius) ** 2)
