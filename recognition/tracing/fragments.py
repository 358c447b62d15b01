"""Fragments: the visible parts of the strands, as nodes linked in order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from recognition.parameters import ChainParameters
from recognition.tracing.height_map import HeightMap
from recognition.tracing.nodes import CentreLineNodes

SPACING_RADII = 0.7
"""A node nearer than this, in radii, to a better-supported node of the same strand is represented by that node."""
MIN_PARALLEL_COSINE = np.cos(np.radians(45))
"""Nodes whose directions differ by more than 45 degrees do not represent each other."""
MIN_LINK_COSINE = np.cos(np.radians(35))
"""A link leaves and enters its nodes within 35 degrees of their directions."""
MAX_LINK_RADII = 2.2
"""Maximum length of a link in radii, if nothing is known about the space between its nodes."""
MAX_DENSE_LINK_RADII = 1.5
"""Distance of two nodes, in radii, up to which they leave no hole. A longer link must not lead over bare table."""
MIN_END_SUPPORT_SHARE = 0.45
"""Minimum support of the nodes at the ends of a fragment, as a share of its median support.

Nodes with less are drawn aside by the flank of another strand: next to a strand that passes over, the corner between
the two gives centre points that belong to neither.
"""
MIN_NODES = 3
"""Minimum number of nodes of a fragment. Fewer nodes show no direction."""
MIN_RING_NODES = 12
"""Minimum number of nodes of a closed fragment. Fewer nodes do not go round the string's own thickness."""
MIN_MEDIAN_RHO = 0.66
"""Minimum of a fragment's median contribution rate: lines on a flat surface have about 1/2, strings above 0.8."""


@dataclass(frozen=True, eq=False)
class Fragment:
    """Nodes of one strand in order."""

    points: NDArray[np.float64]
    """(N, 3) points, metres, base frame."""
    support: NDArray[np.float64]
    """(N,) support of each node."""
    closed: bool = False
    """Whether the last node is linked to the first."""

    def split(self, keep: NDArray[np.bool_], cut: NDArray[np.bool_]) -> list["Fragment"]:
        """Return the parts that are left after nodes are removed and links are cut.

        Args:
            keep: (N,) False for nodes to remove.
            cut: (N,) True for links to cut. Link k leads from node k to the next one; in a closed fragment, the last
                link leads to the first node.

        Returns:
            The parts in order. Parts with fewer than `MIN_NODES` nodes are dropped.
        """
        if keep.all() and not (cut if self.closed else cut[:-1]).any():
            return [self]
        is_broken = cut | ~keep | ~np.roll(keep, -1)
        is_broken[-1] |= not self.closed
        first = (int(np.flatnonzero(is_broken)[-1]) + 1) % len(is_broken)
        order = np.roll(np.arange(len(is_broken)), -first)
        runs = np.split(order, np.flatnonzero(is_broken[order])[:-1] + 1)
        return [
            Fragment(self.points[run], self.support[run]) for run in runs if keep[run].all() and len(run) >= MIN_NODES
        ]


def link_nodes(nodes: CentreLineNodes, parameters: ChainParameters) -> list[Fragment]:
    """Return the fragments: the strands as far as they can be followed from node to node.

    Every node has two sides, one along its direction and one against it. Each side takes at most one link. The
    straightest and shortest links are made first. A side without a link is the end of a fragment.

    Only the best-supported nodes are linked; each represents the nodes beside it. Two representatives can be farther
    apart than `MAX_LINK_RADII` although the nodes between them leave no hole. They are linked at the end if both sides
    are still free.

    Args:
        nodes: Nodes of the centre line.
        parameters: Radius r.

    Returns:
        The fragments, open ones first. Poorly supported nodes at the ends are removed. Fragments with few nodes or with
        a low contribution rate are dropped.

    Source:
        Ours. It replaces the search with two spheres (section II.G) and the bifurcated restart (section III.D, eq. 7).
    """
    all_nodes, r = nodes, parameters.r
    representatives, represented_by = np.unique(_find_representatives(nodes, r), return_inverse=True)
    nodes = all_nodes[representatives]
    neighbours = np.full((len(representatives), 2), -1)
    _add_links(neighbours, nodes, _nearby_pairs(nodes, MAX_LINK_RADII * r))
    pairs = _nearby_pairs(all_nodes, MAX_DENSE_LINK_RADII * r)
    pairs = represented_by[pairs[_rate_links(all_nodes, pairs)[0]]]
    _add_links(neighbours, nodes, np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0))
    fragments = []
    for linked, closed in _walk_links(neighbours):
        path = linked if closed else _trim_ends(linked, nodes.support)
        if np.median(nodes.rho[path]) < MIN_MEDIAN_RHO:
            continue
        if len(path) >= (MIN_RING_NODES if closed else MIN_NODES):
            fragments.append(Fragment(nodes.points[path], nodes.support[path], closed))
    return fragments


def split_over_bare_table(fragments: Sequence[Fragment], height_map: HeightMap, r: float) -> list[Fragment]:
    """Return the fragments, split where a long link leads over bare table.

    Such a link connects the ends of two strings that lie in one line.

    Args:
        fragments: Fragments of the scene.
        height_map: Height map of the registered surface.
        r: Radius of the string, metres.

    Returns:
        The parts of the fragments.

    Source:
        Ours.
    """
    parts = []
    for fragment in fragments:
        points = fragment.points
        following = np.roll(points, -1, axis=0)
        cut = np.linalg.norm(following - points, axis=1) > MAX_DENSE_LINK_RADII * r
        if cut.any():
            cut[cut] = height_map.occlusion((points[cut] + following[cut]) / 2, r).is_bare
        parts += fragment.split(np.ones(len(points), dtype=bool), cut)
    return parts


def _find_representatives(nodes: CentreLineNodes, r: float) -> NDArray[np.int64]:
    """Return (N,) the node that represents each node: the best-supported one takes those beside it, then the next."""
    i, j = _nearby_pairs(nodes, 2 * r).T
    offset = nodes.points[j] - nodes.points[i]
    along = np.abs((offset * nodes.directions[i]).sum(axis=1))
    across = np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0))
    is_parallel = np.abs((nodes.directions[i] * nodes.directions[j]).sum(axis=1)) > MIN_PARALLEL_COSINE
    is_same = (along < SPACING_RADII * r) & (across < SPACING_RADII * r) & is_parallel
    i, j = np.concatenate([i[is_same], j[is_same]]), np.concatenate([j[is_same], i[is_same]])
    beside = csr_array((np.ones(len(i), dtype=bool), (i, j)), shape=(len(nodes.points),) * 2)
    representative = np.full(len(nodes.points), -1)
    for node in np.argsort(-nodes.support, kind="stable"):
        if representative[node] < 0:
            around = beside.indices[beside.indptr[node] : beside.indptr[node + 1]]
            representative[around[representative[around] < 0]] = representative[node] = node
    return representative


def _nearby_pairs(nodes: CentreLineNodes, max_distance: float) -> NDArray[np.int64]:
    """Return (M, 2) the pairs of nodes that are at most `max_distance` apart."""
    if len(nodes.points) == 0:
        return np.empty((0, 2), dtype=np.int64)
    return KDTree(nodes.points).query_pairs(max_distance, output_type="ndarray").astype(np.int64)


def _rate_links(
    nodes: CentreLineNodes, pairs: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.int64]]:
    """Return for each of the `pairs` (M, 2) whether a link is possible, its cost, and (M, 2) the sides it takes.

    A possible link leaves and enters along the directions of its nodes. The cost is the length with a bending penalty.
    """
    a, b = pairs.T
    link = nodes.points[b] - nodes.points[a]
    length = np.linalg.norm(link, axis=1)
    link /= np.maximum(length, 1e-12)[:, None]
    leaving, arriving = (link * nodes.directions[a]).sum(axis=1), (link * nodes.directions[b]).sum(axis=1)
    is_possible = (np.abs(leaving) > MIN_LINK_COSINE) & (np.abs(arriving) > MIN_LINK_COSINE)
    bend = 2 * (1 - leaving**2) + 2 * (1 - arriving**2)
    return is_possible, length * (1 + bend), np.column_stack([leaving > 0, arriving < 0]).astype(np.int64)


def _add_links(neighbours: NDArray[np.int64], nodes: CentreLineNodes, pairs: NDArray[np.int64]) -> None:
    """Link the possible `pairs` (M, 2) whose sides are both free, in the order of their cost.

    `neighbours` (N, 2) holds the node linked to each node against and along its direction, -1 for none.
    """
    is_possible, cost, sides = _rate_links(nodes, pairs)
    a, b = pairs.T
    order = np.argsort(cost, kind="stable")
    for k in order[is_possible[order]]:
        if neighbours[a[k], sides[k, 0]] < 0 and neighbours[b[k], sides[k, 1]] < 0:
            neighbours[a[k], sides[k, 0]], neighbours[b[k], sides[k, 1]] = b[k], a[k]


def _walk_links(neighbours: NDArray[np.int64]) -> list[tuple[list[int], bool]]:
    """Return the nodes along the links of each path, and whether the path is closed."""
    links = [[int(k) for k in row if k >= 0] for row in neighbours]
    is_visited = np.zeros(len(links), dtype=bool)
    paths = []
    # The first pass walks open paths from their ends. Only closed paths are left for the second pass.
    for ends_first in (True, False):
        for start in range(len(links)):
            if is_visited[start] or (ends_first and len(links[start]) == 2):
                continue
            path, following = [start], links[start][0] if links[start] else None
            while following is not None and following != start:
                path.append(following)
                following = next((k for k in links[following] if k != path[-2]), None)
            is_visited[path] = True
            paths.append((path, following is not None))
    return paths


def _trim_ends(path: list[int], support: NDArray[np.float64]) -> list[int]:
    """Remove poorly supported nodes from both ends of a path."""
    supported = np.flatnonzero(support[path] >= MIN_END_SUPPORT_SHARE * np.median(support[path]))
    return path[supported[0] : supported[-1] + 1]
