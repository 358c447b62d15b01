"""Correspondences: points of two views on the same piece of surface."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud

MAX_ANCHORS = 400
"""Maximum number of source points for which a match is searched in a target view. It suffices for any string length."""
MAX_DISTANCE_RADII = 1.0
"""Maximum distance between two corresponding points, in radii r."""
MIN_COSINE = 0.7
"""Minimum cosine of the angle between the two normals. Surfaces that lie back to back are not the same surface."""
N_FULLY_COMPARED = 8
"""Number of first views that are all compared with each other. Most scans have no more views."""
MAX_EARLIER_VIEWS = 4
"""Number of earlier views with which each further view is compared. Every view is compared with about twice as many,
because later views are compared with it."""
LOOK_AHEAD_M = 0.4
"""Distance of the point in front of a camera that represents its viewing direction, metres. It is a usual working
distance."""
MIN_PAIRS = 20
"""Minimum number of point pairs of two overlapping views. Fewer pairs do not constrain the poses of the two views."""


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Pairs of points of two views that lie on the same piece of surface."""

    source_view: int
    """Index of the view whose points are the source points."""
    target_view: int
    """Index of the view in which a match of each source point was searched."""
    source_indices: NDArray[np.intp]
    """(M,) indices of the source points in the cloud of the source view."""
    target_indices: NDArray[np.intp]
    """(M,) indices of the matching points in the cloud of the target view."""
    distances: NDArray[np.float64]
    """(M,) distance between the two points of each pair, metres."""
    cosines: NDArray[np.float64]
    """(M,) cosine of the angle between the two normals of each pair."""
    n_searched: int
    """Number of source points for which a match was searched, with or without success."""


@dataclass(frozen=True, eq=False)
class ComparedViews:
    """Views to align, and the correspondences of those that are compared with each other."""

    clouds: Sequence[NormalCloud]
    """Clouds of the V views at the given poses, base frame."""
    is_compared: NDArray[np.bool_]
    """(V, V) symmetric mask of the views that are compared with each other."""
    correspondences: Sequence[Correspondences]
    """Correspondences of the compared views at the given poses."""

    def without(self, excluded: Collection[int]) -> "ComparedViews":
        """Return the views without those whose view index is `excluded`."""
        kept = [k for k, cloud in enumerate(self.clouds) if cloud.view not in excluded]
        correspondences = [
            overlap
            for overlap in self.correspondences
            if overlap.source_view not in excluded and overlap.target_view not in excluded
        ]
        return ComparedViews([self.clouds[k] for k in kept], self.is_compared[np.ix_(kept, kept)], correspondences)


def compared_earlier_views(clouds: Sequence[NormalCloud]) -> NDArray[np.intp]:
    """Return the list indices (K,) of the earlier views with which the last view is compared.

    They are the nearest earlier views by camera position and viewing direction, so the number of pairs is linear in the
    number of views. The choice is made when a view arrives, and later views do not change it: the search then runs
    while the arm moves. Since each view has an earlier partner, all views hang together in any order of arrival. The
    nearest views among all, chosen after the last one, might form separate groups.

    Args:
        clouds: Views in the order of arrival, the last view included.
    """
    *earlier, last = clouds
    if len(earlier) < N_FULLY_COMPARED:
        return np.arange(len(earlier))
    distances = np.linalg.norm(np.array([_viewpoint(cloud) for cloud in earlier]) - _viewpoint(last), axis=1)
    return np.sort(np.argsort(distances, kind="stable")[:MAX_EARLIER_VIEWS])


def compared_views(clouds: Sequence[NormalCloud]) -> NDArray[np.bool_]:
    """Return the symmetric mask (V, V) of the views that are compared with each other.

    Args:
        clouds: The V views in the order of arrival.
    """
    is_compared = np.zeros((len(clouds), len(clouds)), dtype=np.bool_)
    for k in range(len(clouds)):
        is_compared[k, compared_earlier_views(clouds[: k + 1])] = True
    return is_compared | is_compared.T


def _viewpoint(cloud: NormalCloud) -> NDArray[np.float64]:
    """Return the camera position and a point in front of the camera (6,). Without a pose, both are the mean point."""
    if cloud.T_base_camera is None:
        return np.tile(cloud.points.mean(axis=0), 2)
    position = cloud.T_base_camera[:3, 3]
    return np.concatenate([position, position + LOOK_AHEAD_M * cloud.T_base_camera[:3, 2]])


def anchor_points(cloud: NormalCloud, max_anchors: int = MAX_ANCHORS) -> NDArray[np.intp]:
    """Return the indices (M,) of at most `max_anchors` points that are evenly spread over the cloud.

    The cloud is sorted by voxel. A constant stride therefore spreads the points over the surface.
    """
    return np.arange(0, len(cloud.points), max(-(-len(cloud.points) // max_anchors), 1))


def find_correspondences(
    cloud: NormalCloud,
    others: Sequence[NormalCloud],
    parameters: ChainParameters,
    max_distance_radii: float = MAX_DISTANCE_RADII,
    min_cosine: float = MIN_COSINE,
    max_anchors: int = MAX_ANCHORS,
    T: NDArray[np.float64] | None = None,
    T_others: Sequence[NDArray[np.float64]] | None = None,
) -> list[Correspondences]:
    """Return the correspondences of `cloud` with each view that it overlaps.

    Args:
        cloud: The source view.
        others: The target views.
        parameters: Method parameters; uses the radius r.
        max_distance_radii: Maximum distance between two corresponding points, in radii r.
        min_cosine: Minimum cosine of the angle between the normals of two corresponding points.
        max_anchors: Maximum number of source points for which a match is searched in a target view.
        T: (4, 4) motion of the source view, base to base. None: the source view does not move.
        T_others: One motion (4, 4) for each target view, base to base. None: the target views do not move.

    Returns:
        One item for each target view with at least `MIN_PAIRS` pairs, in the order of `others`.
    """
    chosen = anchor_points(cloud, max_anchors)
    if T is None:
        T = np.eye(4)
    if T_others is None:
        T_others = [np.eye(4)] * len(others)
    points = cloud.points[chosen] @ T[:3, :3].T + T[:3, 3]
    normals = cloud.normals[chosen] @ T[:3, :3].T
    found = []
    for other, T_other in zip(others, T_others, strict=True):
        # Move the source points into the frame of the tree, because a moved target cloud would need a new tree.
        R = T_other[:3, :3]
        t = T_other[:3, 3]
        distances, nearest = other.tree.query((points - t) @ R, distance_upper_bound=max_distance_radii * parameters.r)
        nearest = np.asarray(nearest)
        near = np.flatnonzero(distances < np.inf)
        cosines = np.einsum("ij,ij->i", normals[near] @ R, other.normals[nearest[near]])
        is_aligned = cosines > min_cosine
        near = near[is_aligned]
        if len(near) >= MIN_PAIRS:
            found.append(
                Correspondences(
                    source_view=cloud.view,
                    target_view=other.view,
                    source_indices=chosen[near],
                    target_indices=nearest[near],
                    distances=distances[near],
                    cosines=cosines[is_aligned],
                    n_searched=len(chosen),
                )
            )
    return found
