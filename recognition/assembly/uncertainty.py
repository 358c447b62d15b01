"""Uncertainty of a fitted strand: sigma and number of views at each point."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from recognition.assembly.hidden_lengths import hidden_variance
from recognition.geometry.polyline import unit_vectors
from recognition.preprocessing.normals import NormalCloud
from recognition.refinement.refinement import FittedStrand
from recognition.registration.registration import Registration

SURFACE_STRIDE = 2
"""Stride of the surface points of a view in the count of views. Every second surface point is enough."""
MIN_VIEW_POINTS = 2
"""Minimum number of surface points beside a point of the strand. With fewer, the view did not see the point."""
SYSTEMATIC_SHARE = 0.35
"""Share of the surface scatter that is common to neighbouring pixels, in a scan of `SYSTEMATIC_VIEWS` views. The
scatter of patches of the table replaces it if it is larger, because the fit of a tube follows slow errors of the depth.

Stereo errors are correlated over about one radius, so the average over the surface beside a point hardly reduces them.
The average over the views does: the variance is inversely proportional to their number. With a single view, the share
is 1. The value was chosen on simulated scans of eight views: with it, 2 sigma covers 95 % of the errors there. It also
covers the larger errors of a short baseline at a long distance.
"""
SYSTEMATIC_VIEWS = 8
"""Maximum number of views that reduce this share. Further views do not, because stereo errors repeat with the
disparity."""
MIN_SIGMA_M = 0.0001
"""Lower limit of sigma, metres. The errors of the lens and of the depth scale are common to all views."""


def point_uncertainty(
    strand: FittedStrand, registration: Registration, scatter_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the sigma across the string and the number of views at each point of a fitted strand.

    An interval of 2 sigma covers the true centre line in 95 % of the cases. The variance is the sum of three terms:

    - pose errors of the views after registration;
    - the error of the fit, from the surface scatter and the support of the point, and where the string is hidden, from
      the fit beside the hidden length and from the bends that the string may have there;
    - errors that are common to all depth measurements.

    Args:
        strand: Fitted strand with N points.
        registration: Registered views with the covariance of their poses.
        scatter_m: Standard deviation of the surface points about the fitted tubes, metres.

    Returns:
        The standard deviation (N,) across the string, metres, and the number (N,) of views that saw each point. The
        number is 0 for bridged points.
    """
    views = np.where(strand.bridged, 0, _count_views(strand, registration.clouds))
    fit = 1.5 * scatter_m**2 / np.maximum(strand.support, 1e-3)
    hidden = strand.bridged
    if hidden.any() and not hidden.all():
        fit[hidden] = hidden_variance(strand, fit)
    patch_m = float(np.median([cloud.scatter.patch_m for cloud in registration.clouds]))
    averaging = SYSTEMATIC_VIEWS / min(len(registration.clouds), SYSTEMATIC_VIEWS)
    common = MIN_SIGMA_M**2 + (SYSTEMATIC_SHARE * max(scatter_m, patch_m)) ** 2 * averaging
    return np.sqrt(_pose_variance(strand.points, registration) + fit + common), views


def _count_views(strand: FittedStrand, clouds: Sequence[NormalCloud]) -> NDArray[np.int64]:
    """Return the numbers (N,) of views with surface points beside each point of the strand."""
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
