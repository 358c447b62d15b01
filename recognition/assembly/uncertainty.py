"""Uncertainty of a fitted strand: one sigma and the number of views at each point."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.geometry.polyline import arc_length, unit_vectors
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.refinement import FittedStrand
from recognition.registration.registration import Registration

SURFACE_STRIDE = 2
"""Only every second surface point of a view is used to decide whether the view saw a point of the line."""
MIN_VIEW_POINTS = 2
"""A view saw a point of the line if it has at least this number of surface points beside it."""
SYSTEMATIC_SHARE = 0.35
"""Share of the surface scatter that is common to all views and to neighbouring pixels.

Averaging does not reduce it: it comes from stereo errors that repeat with the disparity. The value was measured on
simulated scans, so that twice the sigma covers 95 of 100 cases there. It also covers the larger errors of a short
baseline at a long distance.
"""
MIN_SIGMA_M = 0.0001
"""Lower limit of sigma, metres: errors of the lens and of the depth scale are common to all views."""
MIN_HIDDEN_BEND_RADII = 8.0
"""Smallest bend radius, in string radii, with which a hidden string may leave the smooth path."""


def point_uncertainty(
    strand: FittedStrand, registration: Registration, scatter_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return one sigma across the string and the number of views, for each point of the strand.

    Twice the sigma covers the true centre line in 95 of 100 cases. The variance is the sum of four terms:

    - the view poses after registration, which move the whole string;
    - the fit, which depends on the surface scatter and on the number of points that support each point of the line;
    - the errors that are common to all depth measurements;
    - where the string is hidden, the distance by which it may bend unobserved.

    Args:
        strand: Fitted strand with N points.
        registration: Registered views with the covariance of their poses.
        scatter_m: Scatter of the surface about the fitted tubes, metres.

    Returns:
        (N,) one sigma across the string, metres, and (N,) number of views. Bridged points have no view.

    Source:
        Ours.
    """
    views = np.where(strand.bridged, 0, _count_views(strand, registration.clouds))
    fit = 1.5 * scatter_m**2 / np.maximum(strand.support, 1e-3)
    hidden = strand.bridged
    deviation = np.zeros(len(hidden))
    if hidden.any() and not hidden.all():
        s = arc_length(strand.points)
        distance, nearest = KDTree(s[~hidden, None]).query(s[hidden, None])
        fit[hidden] = fit[~hidden][np.asarray(nearest)]
        deviation[hidden] = np.asarray(distance) ** 2 / (2 * MIN_HIDDEN_BEND_RADII * strand.radius_m)
    common = MIN_SIGMA_M**2 + (SYSTEMATIC_SHARE * scatter_m) ** 2
    return np.sqrt(_pose_variance(strand.points, registration) + fit + deviation**2 + common), views


def _count_views(strand: FittedStrand, clouds: Sequence[NormalCloud]) -> NDArray[np.int64]:
    """Return (N,) the number of views that have surface beside each point of the line."""
    tree = KDTree(strand.points)
    n_views = np.zeros(len(strand.points), dtype=np.int64)
    for cloud in clouds:
        points = cloud.points[::SURFACE_STRIDE]
        distance, indices = tree.query(points, distance_upper_bound=1.6 * strand.radius_m)
        nearest = np.asarray(indices)
        beside = (nearest < tree.n) & (np.asarray(distance) > 0.5 * strand.radius_m)
        n_views += np.bincount(nearest[beside], minlength=tree.n) >= MIN_VIEW_POINTS
    return n_views


def _pose_variance(points: NDArray[np.float64], registration: Registration) -> NDArray[np.float64]:
    """Return (N,) the variance of the views' mean displacement at each point, metres squared.

    Across the string there are two directions. The larger variance counts fully and the smaller one by half. Twice
    the root then covers 95 of 100 cases, both for a round error and for an error along a line.
    """
    n = len(registration.covariance) // 6
    mean = np.tile(np.eye(6), (1, n)) / n
    common = mean @ registration.covariance @ mean.T
    x, y, z = (points - registration.centre).T
    o = np.zeros(len(points))
    # A twist (w, t) about the centre moves a point by w x p + t.
    cross = np.stack([np.stack([o, z, -y], 1), np.stack([-z, o, x], 1), np.stack([y, -x, o], 1)], 1)
    J = np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape)], axis=2)
    tangent = unit_vectors(np.gradient(points, axis=0))
    across = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]
    eigenvalues = np.linalg.eigvalsh(across @ (J @ common @ J.transpose(0, 2, 1)) @ across)
    return eigenvalues[:, 2] + 0.5 * eigenvalues[:, 1]
