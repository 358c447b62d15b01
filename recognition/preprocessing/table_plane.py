"""The table plane as each view sees it, used to correct the view's height and tilt."""

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import from_rotation_vector
from recognition.parameters import ChainParameters

PASSES_M = (0.006, 0.003, 0.002)
"""Distances from the plane within which points count as the table's, pass by pass."""
MAX_HEIGHT_M = 0.004
"""A larger offset is not a pose's error: what is seen there is not the table."""
MAX_TILT_RAD = 0.02
"""The same for the slope."""
MIN_SHARE = 0.2
"""Share of the view's points in the workspace that must lie on the plane."""
MIN_SPREAD_M = 0.02
"""Least standard deviation of the table's points in each direction: a narrow strip tells no tilt."""
SAMPLE = 10_000
"""Points are thinned evenly to about this many: a plane needs no more."""


def table_alignment(points: NDArray[np.float64], table_z_m: float, parameters: ChainParameters) -> NDArray[np.float64]:
    """(4, 4) correction in the base frame that brings the table seen in `points` (N, 3) to z = `table_z_m`.

    Every view sees the table before the threshold on z_w takes it away, and the table's height and tilt are known:
    three of the six errors of a view's pose are thereby measured without any other view. The identity where the
    table is not seen well enough to tell. Not in the paper, whose threshold needs it all the same: at 5 mm a
    string of 4.2 mm radius shows 3.4 mm, and poses are off by one.
    """
    points = points[:: max(len(points) // SAMPLE, 1)]
    near = points[np.abs(points[:, 2] - table_z_m) < MAX_HEIGHT_M + PASSES_M[0]]
    # Lower than the string's underside only: the string itself must not pull the plane up.
    near = near[near[:, 2] < table_z_m + parameters.z_t]
    if len(near) < max(MIN_SHARE * len(points), 100):
        return np.eye(4)
    centre = near.mean(axis=0)
    A = np.column_stack([near[:, :2] - centre[:2], np.ones(len(near))])
    plane = np.array([0.0, 0.0, np.median(near[:, 2])])
    on_plane = np.ones(len(near), dtype=bool)
    for width in PASSES_M:
        on_plane = np.abs(near[:, 2] - A @ plane) < width
        if on_plane.sum() < max(MIN_SHARE * len(points), 100):
            return np.eye(4)
        A_on = A[on_plane]
        plane = np.linalg.lstsq(A_on.T @ A_on, A_on.T @ near[on_plane, 2], rcond=None)[0]
    slope_x, slope_y, height = plane
    spread = np.linalg.eigvalsh(np.cov(near[on_plane, :2].T)) ** 0.5
    too_far = abs(height - table_z_m) > MAX_HEIGHT_M or np.hypot(slope_x, slope_y) > MAX_TILT_RAD
    if too_far or spread[0] < MIN_SPREAD_M:
        return np.eye(4)
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    pivot = np.array([centre[0], centre[1], height])
    # The smallest rotation that makes the plane's normal vertical, about the table's middle.
    T = from_rotation_vector((0, 0, 0), np.cross(normal, (0, 0, 1)))
    T[:3, 3] = (centre[0], centre[1], table_z_m) - T[:3, :3] @ pivot
    return T
