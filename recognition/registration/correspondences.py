"""Where two views show the same piece of surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud

ANCHORS = 400
"""Points of a view that look for their like in each other view: enough to place it, whatever its string's length."""
REACH_SHARE = 1.0
"""How far they look, as a share of r, ..."""
MIN_COSINE = 0.7
"""... and the least cosine of the angle between the two normals: what lies back to back is not the same surface."""
FULL_PARTNERS = 7
"""With more views to compare with than these, each is asked for fewer points, ..."""
MIN_ANCHORS = 60
"""... but so many at least: time then grows with the number of views and not with its square."""
MIN_PAIRS = 20
"""Fewer than this between two views decide nothing."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Points of two views that lie on the same piece of surface."""

    first: int
    """Index of the view whose points looked for their like."""
    second: int
    """Index of the view in which they found it."""
    at_first: NDArray[np.intp]
    """(M,) which points of the first view's cloud."""
    at_second: NDArray[np.intp]
    """(M,) which of the second's they found."""
    distance: NDArray[np.float64]
    """(M,) how far they had to go, metres."""
    cosine: NDArray[np.float64]
    """(M,) of the angle between the two normals."""
    looked: int
    """How many points looked."""


def anchor_points(cloud: NormalCloud, count: int = ANCHORS) -> NDArray[np.intp]:
    """(M,) which points of the cloud look: at most `count`, evenly spread, as its voxels come in order of place."""
    return np.arange(0, len(cloud.points), max(-(-len(cloud.points) // count), 1))


def find_correspondences(
    cloud: NormalCloud,
    others: Sequence[NormalCloud],
    parameters: ChainParameters,
    reach: float = REACH_SHARE,
    min_cosine: float = MIN_COSINE,
    count: int = ANCHORS,
    T: NDArray[np.float64] | None = None,
    T_others: Sequence[NDArray[np.float64]] | None = None,
) -> list[Correspondences]:
    """The overlaps of `cloud` with each of the other views; those with too few pairs to decide anything are left out.

    Clouds are looked at as moved by `T` (4, 4) and `T_others` where these are given.
    """
    chosen = anchor_points(cloud, max(count * FULL_PARTNERS // max(len(others), FULL_PARTNERS), MIN_ANCHORS))
    T = np.eye(4) if T is None else T
    points, normals = cloud.points[chosen] @ T[:3, :3].T + T[:3, 3], cloud.normals[chosen] @ T[:3, :3].T
    found = []
    for k, other in enumerate(others):
        # The other's tree stays where it was built: the points are brought there.
        R, t = (np.eye(3), np.zeros(3)) if T_others is None else (T_others[k][:3, :3], T_others[k][:3, 3])
        distance, nearest = other.tree.query((points - t) @ R, distance_upper_bound=reach * parameters.r)
        nearest, near = np.asarray(nearest), np.flatnonzero(distance < np.inf)
        cosine = np.einsum("ij,ij->i", normals[near] @ R, other.normals[nearest[near]])
        alike = cosine > min_cosine
        near = near[alike]
        if len(near) >= MIN_PAIRS:
            found.append(
                Correspondences(
                    cloud.view, other.view, chosen[near], nearest[near], distance[near], cosine[alike], len(chosen)
                )
            )
    return found
