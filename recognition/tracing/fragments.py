"""Fragments of strings: nodes of the centre line linked in order, as far as the string is seen without a gap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from recognition.parameters import ChainParameters
from recognition.tracing.height_map import HeightMap
from recognition.tracing.nodes import CentreLineNodes

SPACING_SHARE = 0.7
"""Nodes nearer than this share of r to a better borne one of the same strand stand for the same place."""
ONWARD = np.cos(np.radians(35))
"""A link leaves and enters its nodes within this angle of their directions."""
REACH_SHARE = 2.2
"""Longest link, as a share of r, where nothing is known of what lies between its nodes."""
LONG_SHARE = 1.5
"""A link longer than this, as a share of r, must not lead over bare table; nodes no farther apart leave no hole."""
SUPPORTED = 0.45
"""Nodes at a fragment's ends with less than this share of its usual support are drawn aside by another strand's
flank: next to a strand that passes over, the corner between the two gives centre points of neither."""
MIN_NODES = 3
"""Fewer linked nodes show no direction."""
MIN_RING = 12
"""Fewer linked nodes don't go round a string's own thickness."""
MIN_RHO = 0.66
"""Median contribution rate of a fragment: that of lines on a flat surface is about 1/2, a string's above 0.8."""


@dataclass(frozen=True, eq=False)
class Fragment:
    """Nodes of one strand in order."""

    points: NDArray[np.float64]
    """(N, 3)."""
    support: NDArray[np.float64]
    """(N,)."""
    closed: bool = False
    """The last node links to the first."""

    def pieces(self, kept: NDArray[np.bool_], cut: NDArray[np.bool_]) -> list["Fragment"]:
        """What is left without the nodes that are not `kept` (N,) and the links that are `cut` (N,).

        Link k leads from node k to the next; of a closed fragment, the last one leads to the first node. Pieces of
        fewer than `MIN_NODES` nodes are left out.
        """
        if kept.all() and not (cut if self.closed else cut[:-1]).any():
            return [self]
        broken = cut | ~kept | ~np.roll(kept, -1)
        broken[-1] |= not self.closed
        first = (int(np.flatnonzero(broken)[-1]) + 1) % len(broken)
        order = np.roll(np.arange(len(broken)), -first)
        runs = np.split(order, np.flatnonzero(broken[order])[:-1] + 1)
        return [
            Fragment(self.points[run], self.support[run]) for run in runs if kept[run].all() and len(run) >= MIN_NODES
        ]


def link_nodes(nodes: CentreLineNodes, parameters: ChainParameters) -> list[Fragment]:
    """The strands as far as they can be followed from node to node.

    Every node has two sides, one in its direction and one against it, and each side has one link at most: the
    straightest and shortest first. Sides without a link are fragments' ends.

    Nodes that stand for those beside them may be farther apart than a link reaches, though the nodes they stand for
    leave no hole between them. Sides that are still without a link have a longer one there.
    """
    every, standing, r = nodes, _standing(nodes, parameters.r), parameters.r
    kept, stands_for = np.unique(standing, return_inverse=True)
    nodes = every[kept]
    neighbours = np.full((len(kept), 2), -1)
    _add_links(neighbours, nodes, _pairs(nodes, REACH_SHARE * r))
    pairs = _pairs(every, LONG_SHARE * r)
    pairs = stands_for[pairs[_onward(every, pairs)[0]]]
    _add_links(neighbours, nodes, np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0))
    fragments = []
    for linked, closed in _paths(neighbours):
        path = linked if closed else _supported(linked, nodes.support)
        if np.median(nodes.rho[path]) < MIN_RHO:
            continue
        if len(path) >= (MIN_RING if closed else MIN_NODES):
            fragments.append(Fragment(nodes.points[path], nodes.support[path], closed))
    return fragments


def split_over_bare_table(fragments: Sequence[Fragment], cover: HeightMap, r: float) -> list[Fragment]:
    """The fragments cut in two where a long link leads over bare table: there, two strings lie in line."""
    parts = []
    for fragment in fragments:
        points = fragment.points
        following = np.roll(points, -1, axis=0)
        cut = np.linalg.norm(following - points, axis=1) > LONG_SHARE * r
        if cut.any():
            cut[cut] = cover.over((points[cut] + following[cut]) / 2, r)[1]
        parts += fragment.pieces(np.ones(len(points), dtype=bool), cut)
    return parts


def _standing(nodes: CentreLineNodes, r: float) -> NDArray[np.int64]:
    """(N,) the node that stands for each one's place: the best borne, in turn, keeps those beside it out."""
    i, j = _pairs(nodes, 2 * r).T
    offset = nodes.points[j] - nodes.points[i]
    along = np.abs((offset * nodes.directions[i]).sum(axis=1))
    across = np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0))
    parallel = np.abs((nodes.directions[i] * nodes.directions[j]).sum(axis=1)) > np.cos(np.radians(45))
    same = (along < SPACING_SHARE * r) & (across < SPACING_SHARE * r) & parallel
    i, j = np.concatenate([i[same], j[same]]), np.concatenate([j[same], i[same]])
    beside = csr_array((np.ones(len(i), dtype=bool), (i, j)), shape=(len(nodes.points),) * 2)
    standing = np.full(len(nodes.points), -1)
    for node in np.argsort(-nodes.support, kind="stable"):
        if standing[node] < 0:
            around = beside.indices[beside.indptr[node] : beside.indptr[node + 1]]
            standing[around[standing[around] < 0]] = standing[node] = node
    return standing


def _pairs(nodes: CentreLineNodes, reach: float) -> NDArray[np.int64]:
    """(M, 2) the nodes within `reach` of one another."""
    if len(nodes.points) == 0:
        return np.empty((0, 2), dtype=np.int64)
    return KDTree(nodes.points).query_pairs(reach, output_type="ndarray").astype(np.int64)


def _onward(
    nodes: CentreLineNodes, pairs: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.int64]]:
    """For each of the `pairs` (M, 2): whether a link would leave and enter along the nodes' directions; what it
    costs, its length with a price on bending; and (M, 2) the sides it takes."""
    a, b = pairs.T
    way = nodes.points[b] - nodes.points[a]
    length = np.linalg.norm(way, axis=1)
    way /= np.maximum(length, 1e-12)[:, None]
    leaving, arriving = (way * nodes.directions[a]).sum(axis=1), (way * nodes.directions[b]).sum(axis=1)
    possible = (np.abs(leaving) > ONWARD) & (np.abs(arriving) > ONWARD)
    bend = 2 * (1 - leaving**2) + 2 * (1 - arriving**2)
    return possible, length * (1 + bend), np.column_stack([leaving > 0, arriving < 0]).astype(np.int64)


def _add_links(neighbours: NDArray[np.int64], nodes: CentreLineNodes, pairs: NDArray[np.int64]) -> None:
    """Links the `pairs` (M, 2) where it leads onward and both sides are free, the straightest and shortest first.

    `neighbours` (N, 2) holds the node linked to each against and along its direction, -1 for none.
    """
    possible, cost, sides = _onward(nodes, pairs)
    a, b = pairs.T
    order = np.argsort(cost, kind="stable")
    for k in order[possible[order]]:
        if neighbours[a[k], sides[k, 0]] < 0 and neighbours[b[k], sides[k, 1]] < 0:
            neighbours[a[k], sides[k, 0]], neighbours[b[k], sides[k, 1]] = b[k], a[k]


def _paths(neighbours: NDArray[np.int64]) -> list[tuple[list[int], bool]]:
    """Nodes along the links from end to end, and whether they go round."""
    links = [[int(k) for k in row if k >= 0] for row in neighbours]
    seen = np.zeros(len(links), dtype=bool)
    paths = []
    # Open paths from their ends first; what is left goes round.
    for ends_first in (True, False):
        for start in range(len(links)):
            if seen[start] or (ends_first and len(links[start]) == 2):
                continue
            path, following = [start], links[start][0] if links[start] else None
            while following is not None and following != start:
                path.append(following)
                following = next((k for k in links[following] if k != path[-2]), None)
            seen[path] = True
            paths.append((path, following is not None))
    return paths


def _supported(path: list[int], support: NDArray[np.float64]) -> list[int]:
    borne = np.flatnonzero(support[path] >= SUPPORTED * np.median(support[path]))
    return path[borne[0] : borne[-1] + 1]
