"""Measure the table plane in one view, whether or not it is at the given height."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from recognition.preprocessing.plane_fit import MIN_INLIERS, fit_apart, fit_plane, is_apart
from recognition.preprocessing.table_plane import MAX_HEIGHT_ERROR_M, MAX_TILT_RAD, MIN_LOWER_M, MIN_SPREAD_M
from recognition.preprocessing.target_cloud import DepthView, Scene, deproject, workspace_box

SEARCH_M = 0.05
"""Maximum distance of the table from its given height, metres. A plane farther away is another surface."""
MAX_SLOPE = 0.15
"""Maximum slope of the table. Steeper planes are sides of objects."""
SAMPLE_SIZE = 2500
"""Approximate number of points after even subsampling. It is enough for a plane."""
N_PLANES = 120
"""Number of planes through three random points that are compared. If a third of the points is on the table, at least
one of them has all three points on it, with a probability of 99 %."""
INLIERS_M = (0.003, 0.002, 0.002)
"""Maximum distance of inliers from the plane in each pass of the fit, metres. The first also counts the inliers of the
planes that are compared."""
MAX_COUNTED = 400
"""Approximate maximum number of points that are counted to compare the planes."""
MIN_SHARE = 0.2
"""Minimum number of inliers, as a share of the points in the search range."""
MAX_NEAR_SHARE = 0.05
"""Maximum share of the points in the search range, in a view that shows no table there. They may be depth errors."""
MIN_OTHER_SHARE = 0.15
"""Minimum share of the points on a second plane, for example that of a large flat object on the table."""


@dataclass(frozen=True, eq=False)
class ViewPlane:
    """Plane of the table as one view shows it at its given pose."""

    T_base_camera: NDArray[np.float64]
    """(4, 4) given camera pose, metres."""
    centre: NDArray[np.float64]
    """(3,) mean of the points on the plane, metres, base frame."""
    slope: NDArray[np.float64]
    """(2,) slopes of the plane along x and along y."""
    has_rival: bool = False
    """Whether more points are on another plane above this one, and neither of them is where the table is given."""

    def height_at(self, xy: NDArray[np.float64]) -> float:
        """Return the height of the plane at a position (2,), metres."""
        return float(self.centre[2] + self.slope @ (xy - self.centre[:2]))


def measure_table(view: DepthView, scene: Scene) -> ViewPlane | None:
    """Return the plane of the table in one view, or None if the view shows too little of it.

    The plane of most points is the table. If there is a second plane, the lower one is the table, and the upper one is
    a large flat object on it, unless only the upper one is where the table is given.

    Args:
        view: Depth image with its camera pose.
        scene: Given table height and workspace. Only the sides of the workspace count, because its floor may be as
            wrong as the height of the table.
    """
    _, _, points = pixels_near_table(view, scene, SAMPLE_SIZE)
    if len(points) < MIN_INLIERS:
        return None
    middle = points.mean(axis=0)
    A = np.column_stack([points[:, :2] - middle[:2], np.ones(len(points))])
    plane = _plane_of_most(A, points[:, 2])
    if plane is None:
        return None
    is_inlier = np.ones(len(points), dtype=bool)
    for distance_m in INLIERS_M:
        is_inlier = np.abs(points[:, 2] - A @ plane) < distance_m
        if is_inlier.sum() < MIN_INLIERS:
            return None
        plane = fit_plane(A[is_inlier], points[is_inlier, 2])
    if is_inlier.sum() < MIN_SHARE * len(points):
        return None
    found = _view_plane(view, points, is_inlier, plane)
    other = _other_plane(view, points, A, points[:, 2] - A @ plane)
    if found is None or other is None:
        return found
    is_upper = other.centre[2] > found.height_at(other.centre[:2])
    lower = found if is_upper else other
    upper = other if is_upper else found
    if _is_as_given(lower, scene) or not _is_as_given(upper, scene):
        return replace(lower, has_rival=not is_upper and not _is_as_given(lower, scene))
    return upper


def _other_plane(
    view: DepthView, points: NDArray[np.float64], A: NDArray[np.float64], residual: NDArray[np.float64]
) -> ViewPlane | None:
    """Return the plane of most of the points (N, 3) off a first plane, or None if it has too few points.

    `residual` (N,) is the height of the points above the first plane, metres.
    """
    min_inliers = max(MIN_OTHER_SHARE * len(points), MIN_INLIERS)
    is_below = is_apart(-residual, MIN_LOWER_M, min_inliers)
    is_above = is_apart(residual, INLIERS_M[0], min_inliers)
    for is_other in (is_below, is_above):
        if not is_other.any():
            continue
        first = _plane_of_most(A[is_other], points[is_other, 2])
        if first is None:
            continue
        plane, is_inlier = fit_apart(A, points[:, 2], first)
        if is_inlier.sum() < min_inliers:
            continue
        other = _view_plane(view, points, is_inlier, plane)
        if other is not None and abs(float(residual[is_inlier].mean())) > MIN_LOWER_M:
            return other
    return None


def _view_plane(
    view: DepthView, points: NDArray[np.float64], is_inlier: NDArray[np.bool_], plane: NDArray[np.float64]
) -> ViewPlane | None:
    """Return the plane (3,) of some of the points (N, 3); None if they are too narrow, or the plane is too steep."""
    spread = np.linalg.eigvalsh(np.cov(points[is_inlier, :2].T)) ** 0.5
    if spread[0] < MIN_SPREAD_M or np.hypot(plane[0], plane[1]) > MAX_SLOPE:
        return None
    # A least squares plane passes through the mean of its points.
    return ViewPlane(view.T_base_camera, points[is_inlier].mean(axis=0), plane[:2])


def _is_as_given(plane: ViewPlane, scene: Scene) -> bool:
    """Return whether an error of the pose may have moved the given table to the plane."""
    is_level = bool(np.hypot(plane.slope[0], plane.slope[1]) <= MAX_TILT_RAD)
    return is_level and abs(float(plane.centre[2]) - scene.table_z_m) <= MAX_HEIGHT_ERROR_M


def pixels_near_table(
    view: DepthView, scene: Scene, size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Return the rows (N,), the columns (N,) and the points (N, 3) of pixels near the given table.

    Args:
        view: Depth image with its camera pose.
        scene: Given table height, and sides of the workspace.
        size: Approximate number of pixels after even subsampling of the image.
    """
    rows, columns, points = _pixels_in_sides(view, scene, size)
    near = np.abs(points[:, 2] - scene.table_z_m) <= SEARCH_M
    return rows[near], columns[near], points[near]


def height_far_from_table(view: DepthView, scene: Scene) -> float | None:
    """Return the median height of what a view shows, metres, if nearly all of it is far from the given table.

    Returns:
        The height in the base frame; None if the view shows something near the table, or too little at all.
    """
    _, _, points = _pixels_in_sides(view, scene, SAMPLE_SIZE)
    if len(points) < MIN_INLIERS:
        return None
    is_near = np.abs(points[:, 2] - scene.table_z_m) <= SEARCH_M
    if is_near.mean() > MAX_NEAR_SHARE:
        return None
    return float(np.median(points[:, 2]))


def _pixels_in_sides(
    view: DepthView, scene: Scene, size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Return the rows (N,), the columns (N,) and the points (N, 3) of pixels within the sides of the workspace."""
    step = int(np.ceil(np.sqrt(max(view.depth.size / size, 1.0))))
    subsampled = view.depth[step // 2 :: step, step // 2 :: step]
    rows, columns = (index * step + step // 2 for index in np.nonzero(subsampled))
    points = deproject(view, rows, columns)
    low, high = workspace_box(scene)[:2].T
    inside = np.all((points[:, :2] >= low) & (points[:, :2] <= high), axis=1)
    return rows[inside], columns[inside], points[inside]


def _plane_of_most(A: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the plane (slope along x, slope along y, height) near most of the points; None without three points.

    Args:
        A: (N, 3) rows (x, y, 1) of the points.
        z: (N,) heights of the points, metres.
    """
    chosen = np.random.default_rng(0).integers(len(z), size=(N_PLANES, 3))
    wide = np.abs(np.linalg.det(A[chosen])) > MIN_SPREAD_M**2
    if not wide.any():
        return None
    planes = np.linalg.solve(A[chosen[wide]], z[chosen[wide], None])[..., 0]
    planes = planes[np.hypot(planes[:, 0], planes[:, 1]) < MAX_SLOPE]
    if len(planes) == 0:
        return None
    step = max(len(z) // MAX_COUNTED, 1)
    count = (np.abs(planes @ A[::step].T - z[::step]) < INLIERS_M[0]).sum(axis=1)
    return np.asarray(planes[int(count.argmax())], dtype=np.float64)
