"""How well each point of a chain is known: how many views saw it, and how far they agree."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.neighbours import neighbourhood_means
from recognition.geometry.polyline import arc_length
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.strand import Strand

SIGMA_FLOOR_M = 0.0002
"""No point is claimed better than this: the views share the hand-eye calibration's error."""


def point_uncertainty(
    strand: Strand, clouds: Sequence[NormalCloud], parameters: ChainParameters
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(N,) one sigma across the string, metres, and (N,) number of views, for each point of the strand.

    Each view has its own opinion of the centre line: the mean of its c_i (eq. 1) within r. Sigma is the spread of
    these opinions about the point. Where no view saw the string (under a crossing), sigma grows with the square of
    the way to the next seen point, as a string's sideways bend of radius 5 r would carry it.
    """
    points = strand.points
    tangent = np.gradient(points, axis=0) if len(points) > 1 else np.zeros_like(points)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    offsets = []
    for cloud in clouds:
        # The points within 2 r of the strand hold all its c_i; a tree of all c_i for each strand takes far longer.
        near = np.unique(np.concatenate(list(cloud.tree.query_ball_point(points, 2 * parameters.r)))).astype(np.intp)
        single = cloud.points[near] - parameters.r * cloud.normals[near]
        means = neighbourhood_means(points, single, single, parameters.r)
        offset = means - points
        offset -= (offset * tangent).sum(axis=1, keepdims=True) * tangent
        offsets.append(np.linalg.norm(offset, axis=1))
    distance = np.array(offsets).reshape(-1, len(points))
    seen = np.isfinite(distance) & ~_hidden(strand, clouds, parameters)
    views = seen.sum(axis=0)
    square = (np.where(seen, distance, 0.0) ** 2).sum(axis=0) / np.maximum(views, 1)
    sigma = np.hypot(np.sqrt(square), SIGMA_FLOOR_M)
    unseen = views == 0
    if unseen.all():
        return np.full(len(points), parameters.r), views.astype(np.int64)
    s = arc_length(points)
    gap, nearest = KDTree(s[~unseen, None]).query(s[unseen, None])
    sigma[unseen] = sigma[~unseen][nearest] + gap**2 / (10 * parameters.r)
    return sigma, views.astype(np.int64)


def _hidden(strand: Strand, clouds: Sequence[NormalCloud], parameters: ChainParameters) -> NDArray[np.bool_]:
    """(N,) bridged points that another strand covers: there the surface's top is not this strand's own, r above it.

    Both strands of an intersection are bridged, but the over one was seen all the same.
    """
    hidden = strand.bridged.copy()
    if not hidden.any():
        return hidden
    surface = np.vstack([np.empty((0, 3)), *(cloud.points for cloud in clouds)])
    low, high = (end(strand.points[hidden, :2], axis=0) for end in (np.min, np.max))
    beside = (surface[:, :2] > low - parameters.r) & (surface[:, :2] < high + parameters.r)
    surface = surface[beside.all(axis=1)]
    from_above = KDTree(surface[:, :2])
    for i in np.flatnonzero(strand.bridged):
        near = from_above.query_ball_point(strand.points[i, :2], parameters.r / 2)
        if near and np.percentile(surface[near, 2], 90) < strand.points[i, 2] + 1.5 * parameters.r:
            hidden[i] = False
    return hidden
