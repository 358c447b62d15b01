"""How well each point of a fitted strand is known: an honest sigma, and how many views saw it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.refinement import FittedStrand
from recognition.registration.registration import Registration

LOOKED_AT = 2
"""Of so many surface points of a view one is looked at."""
SEEN_BY = 2
"""Surface points that a view must have beside a point of the line to have seen it."""
SYSTEMATIC_SHARE = 0.35
"""Share of the surface's scatter that is the same in all views and in neighbouring pixels, so that nothing averages it
out: errors of stereo that repeat with the disparity. Measured on simulated scans, so that twice the sigma holds 95 of
100 there, and of all that comes out of a short baseline at a long distance too."""
FLOOR_M = 0.0001
"""No point is claimed better than this: lens and depth scale are common to all views."""
BRIDGE_BEND = 8.0
"""Bend radius, in string radii, by which a string may leave the smooth way where it is hidden."""


def point_uncertainty(
    strand: FittedStrand, registration: Registration, scatter_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(N,) one sigma across the string, metres, and (N,) number of views, for each point of the strand.

    Twice the sigma holds the true centre line in 95 of 100 cases. Four errors add up: that of the views' poses after
    registration, which moves the whole string; that of the fit, from the surface's scatter and how much of it bears
    the point; that which all depth shares; and, where the string is hidden, how far it may bend unseen.
    """
    views = np.where(strand.bridged, 0, _views(strand, registration.clouds))
    fit = 1.5 * scatter_m**2 / np.maximum(strand.support, 1e-3)
    unseen = strand.bridged
    hidden = np.zeros(len(unseen))
    if unseen.any() and not unseen.all():
        s = arc_length(strand.points)
        way, nearest = KDTree(s[~unseen, None]).query(s[unseen, None])
        fit[unseen] = fit[~unseen][np.asarray(nearest)]
        hidden[unseen] = np.asarray(way) ** 2 / (2 * BRIDGE_BEND * strand.radius_m)
    common = FLOOR_M**2 + (SYSTEMATIC_SHARE * scatter_m) ** 2
    return np.sqrt(_pose_variance(strand.points, registration) + fit + hidden**2 + common), views


def _views(strand: FittedStrand, clouds: Sequence[NormalCloud]) -> NDArray[np.int64]:
    """(N,) how many views have surface about each point of the line."""
    tree = KDTree(strand.points)
    counts = np.zeros(len(strand.points), dtype=np.int64)
    for cloud in clouds:
        points = cloud.points[::LOOKED_AT]
        distance, found = tree.query(points, distance_upper_bound=1.6 * strand.radius_m)
        nearest = np.asarray(found)
        beside = (nearest < tree.n) & (np.asarray(distance) > 0.5 * strand.radius_m)
        counts += np.bincount(nearest[beside], minlength=tree.n) >= SEEN_BY
    return counts


def _pose_variance(points: NDArray[np.float64], registration: Registration) -> NDArray[np.float64]:
    """(N,) variance of the mean of the views' displacements at each point, metres squared.

    Of the two directions across the string the worse counts whole and the better half: then twice the root holds
    95 of 100, for a round error and for one along a line alike.
    """
    n = len(registration.covariance) // 6
    mean = np.tile(np.eye(6), (1, n)) / n
    common = mean @ registration.covariance @ mean.T
    x, y, z = (points - registration.centre).T
    o = np.zeros(len(points))
    # A twist (w, t) about the centre moves a point by w x p + t.
    cross = np.stack([np.stack([o, z, -y], 1), np.stack([-z, o, x], 1), np.stack([y, -x, o], 1)], 1)
    J = np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape)], axis=2)
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    across = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]
    eigenvalues = np.linalg.eigvalsh(across @ (J @ common @ J.transpose(0, 2, 1)) @ across)
    return eigenvalues[:, 2] + 0.5 * eigenvalues[:, 1]
