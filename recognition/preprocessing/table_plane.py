"""Align a view to the table plane: correct the height and the tilt of its camera pose."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from recognition.parameters import ChainParameters
from recognition.preprocessing.plane_fit import MIN_INLIERS, fit_apart, fit_plane, is_apart, is_other_peak

INLIER_DISTANCES_M = (0.006, 0.003, 0.002)
"""Maximum distance of inliers from the plane in each pass of the fit, metres."""
MAX_HEIGHT_ERROR_M = 0.004
"""Maximum height error of a camera pose, metres. A plane with a larger offset is not the table."""
MAX_TILT_RAD = 0.02
"""Maximum tilt error of a camera pose, radians. A plane with a larger tilt is not the table."""
MIN_INLIER_SHARE = 0.2
"""Minimum number of inliers of the plane, as a share of the points of the view in the workspace."""
MIN_LOWER_M = 0.0012
"""Minimum depth below the fitted plane of points that belong to a lower plane, metres. With much noise it is larger."""
MIN_LOWER_SHARE = 0.15
"""Minimum share of points below the fitted plane that shows a lower plane. The table is the lower one of two."""
MIN_SPREAD_M = 0.02
"""Minimum standard deviation of the inliers in each direction, metres. A narrow strip does not determine the tilt."""
SAMPLE_SIZE = 10_000
"""Approximate number of points after even subsampling. It is enough for a plane."""


def table_alignment(points: NDArray[np.float64], table_z_m: float, parameters: ChainParameters) -> NDArray[np.float64]:
    """Return the correction that moves the table plane of one view to the nominal height and tilt.

    The plane is fitted before the height threshold removes the table. It determines three of the six degrees of freedom
    of the pose error from one view alone. The height threshold of the paper needs this correction: a string of radius
    4.2 mm rises only 3.4 mm above the threshold of 5 mm, and pose errors reach 1 mm.

    Args:
        points: (N, 3) points of the view in the workspace, base frame, metres.
        table_z_m: Nominal height of the table plane in the base frame, metres.
        parameters: Method parameters; uses the height threshold z_t.

    Returns:
        Correction (4, 4), base to base, metres. It is the identity if too little of the table is visible, or if the
        correction exceeds the maximum pose error.
    """
    points = points[:: max(len(points) // SAMPLE_SIZE, 1)]
    near = points[np.abs(points[:, 2] - table_z_m) < MAX_HEIGHT_ERROR_M + INLIER_DISTANCES_M[0]]
    # Points of a string above z_t would pull the plane up.
    near = near[near[:, 2] < table_z_m + parameters.z_t]
    min_inliers = max(MIN_INLIER_SHARE * len(points), MIN_INLIERS)
    if len(near) < min_inliers:
        return np.eye(4)
    centre = near.mean(axis=0)
    A = np.column_stack([near[:, :2] - centre[:2], np.ones(len(near))])
    plane = np.array([0.0, 0.0, np.median(near[:, 2])])
    is_inlier = np.ones(len(near), dtype=bool)
    for distance_m in INLIER_DISTANCES_M:
        is_inlier = np.abs(near[:, 2] - A @ plane) < distance_m
        if is_inlier.sum() < min_inliers:
            return np.eye(4)
        plane = fit_plane(A[is_inlier], near[is_inlier, 2])
    is_lower = is_apart(A @ plane - near[:, 2], MIN_LOWER_M, max(MIN_LOWER_SHARE * len(near), MIN_INLIERS))
    if is_lower.any():
        # A large flat object covers part of the table.
        lower, is_on_lower = fit_apart(A, near[:, 2], fit_plane(A[is_lower], near[is_lower, 2]))
        if is_on_lower.sum() < MIN_INLIERS:
            return np.eye(4)
        if is_other_peak(near[:, 2] - A @ lower):
            plane = lower
            is_inlier = is_on_lower
    slope_x, slope_y, height = plane
    spread = np.linalg.eigvalsh(np.cov(near[is_inlier, :2].T)) ** 0.5
    is_too_far = abs(height - table_z_m) > MAX_HEIGHT_ERROR_M or np.hypot(slope_x, slope_y) > MAX_TILT_RAD
    if is_too_far or spread[0] < MIN_SPREAD_M:
        return np.eye(4)
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    pivot = np.array([centre[0], centre[1], height])
    # The smallest rotation that makes the normal of the plane vertical, about the centre of the inliers.
    T = from_rotation_vector((0, 0, 0), np.cross(normal, (0, 0, 1)))
    T[:3, 3] = (centre[0], centre[1], table_z_m) - T[:3, :3] @ pivot
    return T
