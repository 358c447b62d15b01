"""Fragments: the visible parts of the centre lines, as linked nodes in order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from recognition.parameters import ChainParameters
from recognition.tracing.nodes import CentreLineNodes
from recognition.tracing.occlusion_map import OcclusionMap

SPACING_RADII = 0.7
"""Maximum distance between a node and its representative, along and across the string, in radii r."""
MIN_PARALLEL_COSINE = np.cos(np.radians(45))
"""Minimum cosine between the directions of a node and its representative (45 degrees)."""
MIN_LINK_COSINE = np.cos(np.radians(35))
"""Minimum cosine between a link and the directions of its two nodes (35 degrees)."""
MAX_LINK_RADII = 2.2
"""Maximum length of a link in the first pass of linking, in radii r."""
MAX_DENSE_LINK_RADII = 1.5
"""Maximum distance between two nodes without a hole between them, in radii r. Longer links may cross bare table."""
MIN_END_SUPPORT_SHARE = 0.45
"""Minimum support of the nodes at the ends of a fragment, as a share of the median support of the fragment.

Nodes with less support may be displaced. In the corner between two strands at a crossing, centre points belong to
neither strand.
"""
MIN_NODES = 3
"""Minimum number of nodes of a fragment. Fewer nodes show no direction."""
MIN_RING_NODES = 12
"""Minimum number of nodes of a closed fragment. A smaller ring is too narrow for the thickness of the string."""
MIN_MEDIAN_RHO = 0.66
"""Minimum median contribution rate of a fragment. Lines on a flat surface have about 0.5, strings above 0.8.

Matching windows of a stereo camera flatten strings, unevenly along them. Strings then have 0.6 to 0.9.
"""
SCENE_RHO = 0.1
"""Amount by which the median rate of a long fragment may be below that of the strings of the scene."""
MIN_LONG_RHO = 0.6
"""Minimum median contribution rate of a long fragment."""
MIN_LONG_NODES = 20
"""Minimum number of nodes of a long fragment. Most lines on a flat surface are shorter."""
MIN_LENGTH_M = 1e-12
"""Lower limit of the length by which a link is divided, metres. It keeps a link of length zero zero."""


@dataclass(frozen=True, eq=False)
class Fragment:
    """Linked nodes of one strand, in order."""

    points: NDArray[np.float64]
    """(N, 3) positions of the nodes, metres, base frame."""
    support: NDArray[np.float64]
    """(N,) support of each node, as in `CentreLineNodes`."""
    closed: bool = False
    """Whether the last node is linked to the first."""

    def split(self, keep: NDArray[np.bool_], cut: NDArray[np.bool_]) -> list["Fragment"]:
        """Remove nodes, cut links and return the remaining parts of the fragment.

        Args:
            keep: (N,) mask of the nodes, False for nodes to remove.
            cut: (N,) mask of the links, True for links to cut. Link k connects node k and the next node. In a closed
                fragment, the last link connects the last node and the first node.

        Returns:
            The parts in order. Parts with fewer than `MIN_NODES` nodes are dropped.
        """
        links_to_cut = cut if self.closed else cut[:-1]
        if keep.all() and not links_to_cut.any():
            return [self]
        is_broken = cut | ~keep | ~np.roll(keep, -1)
        is_broken[-1] |= not self.closed
        first = (int(np.flatnonzero(is_broken)[-1]) + 1) % len(is_broken)
        order = np.roll(np.arange(len(is_broken)), -first)
        runs = np.split(order, np.flatnonzero(is_broken[order])[:-1] + 1)
        return [
            Fragment(self.points[run], self.support[run]) for run in runs if keep[run].all() and len(run) >= MIN_NODES
        ]


@dataclass(frozen=True, eq=False)
class _CandidateLinks:
    """Links between M pairs of nodes."""

    is_possible: NDArray[np.bool_]
    """(M,) mask of the possible links, which are roughly parallel to the directions of their two nodes."""
    cost: NDArray[np.float64]
    """(M,) cost of each link: its length times a bending penalty, metres."""
    sides: NDArray[np.int64]
    """(M, 2) sides that each link takes at its two nodes: 1 along the direction of the node, 0 against it."""


def link_nodes(nodes: CentreLineNodes, parameters: ChainParameters) -> list[Fragment]:
    """Link neighbouring nodes and return the fragments that the links form.

    Every node has two sides: one along its direction and one against its direction. Each side takes at most one link.
    The straightest and shortest links are made first. A fragment ends at a side without a link.

    Only representatives are linked: the best-supported nodes, each of which represents the nodes beside it. Two
    representatives may be farther apart than `MAX_LINK_RADII`, although the represented nodes leave no hole. A second
    pass links them if their sides are still free.

    Args:
        nodes: Nodes of the centre line.
        parameters: Method parameters; uses the radius r.

    Returns:
        The open fragments, then the closed fragments. Poorly supported nodes at open ends are removed. Fragments with
        few nodes or with a low contribution rate are dropped.

    Source:
        The linking is not in the paper. It replaces the search with two spheres (section II.G) and the bifurcated
        restart (section III.D, eq. 7).
    """
    r = parameters.r
    chosen, represented_by = np.unique(_find_representatives(nodes, r), return_inverse=True)
    representatives = nodes[chosen]
    neighbours = np.full((len(chosen), 2), -1)
    _add_links(neighbours, representatives, _nearby_pairs(representatives, MAX_LINK_RADII * r))

    # The second pass links the representatives of nodes that may be linked.
    pairs = _nearby_pairs(nodes, MAX_DENSE_LINK_RADII * r)
    pairs = represented_by[pairs[_rate_links(nodes, pairs).is_possible]]
    is_between_two = pairs[:, 0] != pairs[:, 1]
    pairs = np.unique(np.sort(pairs[is_between_two], axis=1), axis=0)
    _add_links(neighbours, representatives, pairs)

    paths = []
    for linked, closed in _walk_links(neighbours):
        path = linked if closed else _trim_ends(linked, representatives.support)
        if len(path) >= (MIN_RING_NODES if closed else MIN_NODES):
            paths.append((path, closed, float(np.median(representatives.rho[path]))))
    min_long_rho = _min_long_rho([(len(path), rho) for path, _, rho in paths])
    return [
        Fragment(representatives.points[path], representatives.support[path], closed)
        for path, closed, rho in paths
        if rho >= (min_long_rho if len(path) >= MIN_LONG_NODES else MIN_MEDIAN_RHO)
    ]


def split_over_bare_table(fragments: Sequence[Fragment], occlusion_map: OcclusionMap, r: float) -> list[Fragment]:
    """Split the fragments at long links over bare table.

    A long link over bare table connects the ends of two strings that lie end to end.

    Args:
        fragments: Fragments of the scene.
        occlusion_map: Occlusion map of the registered surface.
        r: Radius of the string, metres.

    Returns:
        The fragments and the parts of split fragments.
    """
    parts = []
    for fragment in fragments:
        points = fragment.points
        following = np.roll(points, -1, axis=0)
        is_long = np.linalg.norm(following - points, axis=1) > MAX_DENSE_LINK_RADII * r
        cut = is_long.copy()
        if is_long.any():
            midpoints = (points[is_long] + following[is_long]) / 2
            cut[is_long] = occlusion_map.occlusion(midpoints, r).is_uncovered
        parts += fragment.split(np.ones(len(points), dtype=bool), cut)
    return parts


def _min_long_rho(paths: Sequence[tuple[int, float]]) -> float:
    """Return the minimum median contribution rate of a long fragment.

    The rate of the strings of the scene is the median over the nodes of the long paths that reach `MIN_MEDIAN_RHO`.

    Args:
        paths: Number of nodes and median rate of each path.
    """
    long = [(nodes, rho) for nodes, rho in paths if nodes >= MIN_LONG_NODES and rho >= MIN_MEDIAN_RHO]
    if not long:
        return MIN_MEDIAN_RHO
    nodes, rho = np.transpose(long)
    of_strings = float(np.median(np.repeat(rho, nodes.astype(np.intp))))
    return float(np.clip(of_strings - SCENE_RHO, MIN_LONG_RHO, MIN_MEDIAN_RHO))


def _find_representatives(nodes: CentreLineNodes, r: float) -> NDArray[np.int64]:
    """Return the index (N,) of the node that represents each node.

    In the order of support, each node without a representative represents itself and the free nodes beside it.
    """
    i, j = _nearby_pairs(nodes, 2 * r).T
    offset = nodes.points[j] - nodes.points[i]
    along = np.abs((offset * nodes.directions[i]).sum(axis=1))
    across = np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0))
    is_parallel = np.abs((nodes.directions[i] * nodes.directions[j]).sum(axis=1)) > MIN_PARALLEL_COSINE
    is_same = (along < SPACING_RADII * r) & (across < SPACING_RADII * r) & is_parallel
    n_nodes = len(nodes.points)
    row = np.concatenate([i[is_same], j[is_same]])
    column = np.concatenate([j[is_same], i[is_same]])
    beside = csr_array((np.ones(len(row), dtype=bool), (row, column)), shape=(n_nodes, n_nodes))
    representative = np.full(n_nodes, -1)
    for node in np.argsort(-nodes.support, kind="stable"):
        if representative[node] < 0:
            around = beside.indices[beside.indptr[node] : beside.indptr[node + 1]]
            representative[around[representative[around] < 0]] = node
            representative[node] = node
    return representative


def _nearby_pairs(nodes: CentreLineNodes, max_distance: float) -> NDArray[np.int64]:
    """Return the node pairs (M, 2) that are at most `max_distance` apart, metres."""
    if len(nodes.points) == 0:
        return np.empty((0, 2), dtype=np.int64)
    return KDTree(nodes.points).query_pairs(max_distance, output_type="ndarray").astype(np.int64)


def _rate_links(nodes: CentreLineNodes, pairs: NDArray[np.int64]) -> _CandidateLinks:
    """Rate the links between pairs of nodes. `pairs` (M, 2) are the indices of the two nodes of each link."""
    a, b = pairs.T
    link = nodes.points[b] - nodes.points[a]
    length = np.linalg.norm(link, axis=1)
    link /= np.maximum(length, MIN_LENGTH_M)[:, None]
    leaving = (link * nodes.directions[a]).sum(axis=1)
    arriving = (link * nodes.directions[b]).sum(axis=1)
    bend = 2 * (1 - leaving**2) + 2 * (1 - arriving**2)
    return _CandidateLinks(
        is_possible=(np.abs(leaving) > MIN_LINK_COSINE) & (np.abs(arriving) > MIN_LINK_COSINE),
        cost=length * (1 + bend),
        sides=np.column_stack([leaving > 0, arriving < 0]).astype(np.int64),
    )


def _add_links(neighbours: NDArray[np.int64], nodes: CentreLineNodes, pairs: NDArray[np.int64]) -> None:
    """Add the possible links to `neighbours`, in the order of their cost.

    Each node has two sides, and each side takes one link. A link is skipped if one of its two sides is already linked.

    Args:
        neighbours: (N, 2) index of the node that is linked to each side of a node, -1 for none; changed in place.
            Column 0 is the side against the direction of the node, column 1 the side along the direction.
        nodes: Nodes of the centre line.
        pairs: (M, 2) indices of the two nodes of each candidate link.
    """
    links = _rate_links(nodes, pairs)
    order = np.argsort(links.cost, kind="stable")
    for k in order[links.is_possible[order]]:
        a, b = pairs[k]
        side_a, side_b = links.sides[k]
        if neighbours[a, side_a] < 0 and neighbours[b, side_b] < 0:
            neighbours[a, side_a] = b
            neighbours[b, side_b] = a


def _walk_links(neighbours: NDArray[np.int64]) -> list[tuple[list[int], bool]]:
    """Return the paths along the links: for each path the node indices in order, and whether the path is closed."""
    links = [_linked_nodes(sides) for sides in neighbours.tolist()]
    is_visited = np.zeros(len(links), dtype=bool)
    paths = []
    # The first pass follows open paths from their ends. Only closed paths remain for the second pass.
    for ends_first in (True, False):
        for start in range(len(links)):
            if is_visited[start] or (ends_first and len(links[start]) == 2):
                continue
            path, closed = _follow_links(start, links)
            is_visited[path] = True
            paths.append((path, closed))
    return paths


def _linked_nodes(sides: Sequence[int]) -> list[int]:
    """Return the nodes that are linked to the sides of a node, without the -1 of a side without a link."""
    return [node for node in sides if node >= 0]


def _follow_links(start: int, links: Sequence[Sequence[int]]) -> tuple[list[int], bool]:
    """Return the path from a node along its first link, and whether it leads back to this node."""
    path = [start]
    following = next(iter(links[start]), None)
    while following is not None and following != start:
        path.append(following)
        following = next((node for node in links[following] if node != path[-2]), None)
    return path, following is not None


def _trim_ends(path: list[int], support: NDArray[np.float64]) -> list[int]:
    """Remove poorly supported nodes from the two ends of a path. `support` (N,) holds the support of all nodes."""
    supported = np.flatnonzero(support[path] >= MIN_END_SUPPORT_SHARE * np.median(support[path]))
    return path[supported[0] : supported[-1] + 1]
