"""Uncertainty of a fitted strand: sigma and number of views at each point."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.assembly.fit_variance import fit_variance
from recognition.geometry.polyline import unit_vectors
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.table_scatter import median_patch_m
from recognition.refinement.refinement import FittedStrand
from recognition.registration.registration import Registration

SURFACE_STRIDE = 2
"""Stride of the surface points of a view in the count of views. Every second surface point is enough."""
BESIDE_RADII = (0.5, 1.6)
"""Range of the distances from a point of the strand of the surface points beside it, in radii."""
MIN_VIEW_POINTS = 2
"""Minimum number of surface points beside a point of the strand. With fewer, the view did not see the point."""
SYSTEMATIC_VIEWS = 8
"""Maximum number of views that average the slow error of the depth. Further views do not, because stereo errors repeat
with the disparity."""
DEPTH_FACTOR = 1.8
"""Variance of a string in one view, in variances of a patch of the table that is as wide as the string.

An error that the whole width shares moves the string by as much along the line of sight. Errors of narrower areas at
the position x across a string of width 2 are weighted by 1 - x^2 upwards and by x (1 - x^2)^(1/2) sideways in the fit
of a tube. Both give 6/5 of the variance of the patch. This is the larger result; half of one direction is added."""
MIN_SIGMA_M = 0.0001
"""Lower limit of sigma, metres. No scan shows the errors of the lens that are common to all views."""


def point_uncertainty(
    strand: FittedStrand, registration: Registration, scatter_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the sigma across the string and the number of views at each point of a fitted strand.

    An interval of 2 sigma covers the true centre line in 95 % of the cases. The variance is the sum of four terms:

    - pose errors of the views after registration;
    - the error of the fit (`fit_variance`);
    - slow errors of the depth, which are the same for all pixels beside a point (`_depth_variance`);
    - errors of the depth on the string itself, which the table does not show. The heights of a resting string show them
      upwards, and they are as large sideways.

    Args:
        strand: Fitted strand with N points.
        registration: Registered views with the covariance of their poses.
        scatter_m: Standard deviation of the surface points about the fitted tubes, metres.

    Returns:
        The standard deviation (N,) across the string, metres, and the number (N,) of views that saw each point. The
        number is 0 for bridged points.
    """
    views = np.where(strand.bridged, 0, _count_views(strand, registration.clouds))
    variance = _pose_variance(strand.points, registration) + fit_variance(strand, scatter_m)
    variance += _depth_variance(strand, registration, views, scatter_m)
    variance += strand.height_sigma_m**2
    return np.maximum(np.sqrt(variance), MIN_SIGMA_M), views


def _depth_variance(
    strand: FittedStrand, registration: Registration, views: NDArray[np.int64], scatter_m: float
) -> NDArray[np.float64]:
    """Return the variances (N,) across the string that slow errors of the depth cause at each point, metres squared.

    Stereo errors are correlated over about a radius, so the average over the surface beside a point hardly reduces
    them, but the average over the views does. The scatter of patches of the table measures them. At hidden points, the
    number of views is that of the visible ones beside them.

    Args:
        strand: Fitted strand with N points.
        registration: Registered views.
        views: (N,) number of views that saw each point.
        scatter_m: Standard deviation of the surface points about the tubes, metres. It replaces an unknown scatter of
            the patches.
    """
    patch_m = median_patch_m(cloud.scatter for cloud in registration.clouds)
    if patch_m is None:
        patch_m = scatter_m
    n = len(views)
    seen = np.flatnonzero(views)
    if not len(seen):
        return np.full(n, DEPTH_FACTOR * patch_m**2)
    period = n if strand.closed else None
    near = np.interp(np.arange(n), seen, views[seen], period=period)
    return np.asarray(DEPTH_FACTOR * patch_m**2 / np.minimum(near, SYSTEMATIC_VIEWS), dtype=np.float64)


def _count_views(strand: FittedStrand, clouds: Sequence[NormalCloud]) -> NDArray[np.int64]:
    """Return the numbers (N,) of views with surface points beside each point of the strand."""
    tree = KDTree(strand.points)
    n_views = np.zeros(len(strand.points), dtype=np.int64)
    min_distance, max_distance = (radii * strand.radius_m for radii in BESIDE_RADII)
    for cloud in clouds:
        points = cloud.points[::SURFACE_STRIDE]
        distance, indices = tree.query(points, distance_upper_bound=max_distance)
        nearest = np.asarray(indices)
        beside = (nearest < tree.n) & (np.asarray(distance) > min_distance)
        n_views += np.bincount(nearest[beside], minlength=tree.n) >= MIN_VIEW_POINTS
    return n_views


def _pose_variance(points: NDArray[np.float64], registration: Registration) -> NDArray[np.float64]:
    """Return the variances (N,) across the string that the pose errors cause at each point, metres squared.

    The displacement of a point is the mean of its displacements in all views. The covariance of the displacement across
    the string has two eigenvalues. The variance is the larger eigenvalue plus half the smaller eigenvalue. Twice its
    square root covers 95 % of the errors, whether the smaller eigenvalue is zero or equal to the larger eigenvalue.
    """
    n = len(registration.covariance) // 6
    mean = np.tile(np.eye(6), (1, n)) / n
    common = mean @ registration.covariance @ mean.T
    x, y, z = (points - registration.centre).T
    o = np.zeros(len(points))
    # A rotation vector w and a translation t move a point p, measured from the centre, by w x p + t.
    cross = np.stack([np.stack([o, z, -y], 1), np.stack([-z, o, x], 1), np.stack([y, -x, o], 1)], 1)
    J = np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape)], axis=2)
    tangent = unit_vectors(np.gradient(points, axis=0))
    across = np.eye(3) - tangent[:, :, None] * tangent[:, None, :]
    eigenvalues = np.linalg.eigvalsh(across @ (J @ common @ J.transpose(0, 2, 1)) @ across)
    return eigenvalues[:, 2] + 0.5 * eigenvalues[:, 1]
