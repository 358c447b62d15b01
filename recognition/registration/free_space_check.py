"""Free-space check: no view may see the table where other views see the string."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.errors import ContradictingViewsError
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import anchor_points

MAX_FREE_SPACE_VIOLATION = 0.025
"""Maximum share of another view's surface that may lie in the free space of a view, as the median over all partners.
Views that agree have 0. A view that is 20 mm off along a straight string of 0.4 m has 0.035, and any other wrong view
0.2 or more."""
MIN_FACING_COSINE = 0.5
"""Minimum cosine between a surface's normal and the direction to the camera. Surface seen at a grazing angle is
measured worst and is not checked."""
RING_DIRECTIONS = tuple((np.cos(k * np.pi / 4), np.sin(k * np.pi / 4)) for k in range(8))
"""Directions of the samples in a ring of radius r around a point. The point lies in free space only if all samples
were measured behind it, so that a pose error of a millimetre decides nothing."""
MIN_RING_PIXELS = 2.0
"""Minimum radius of the ring in pixels. It applies where r is smaller than this in the image."""
MIN_MEASURED = 5
"""Minimum number of measured samples, of the nine that are the point and its ring."""
MAX_ROBOT_SIGMA = 10.0
"""Maximum robot error of a view (Mahalanobis norm). A view that needs a larger correction was not captured at the pose
that the arm reported."""
MAX_ROBOT_RATIO = 3.0
"""Maximum ratio of a view's robot error to the median of all views. A view is excluded only if it exceeds both limits:
if the arm is worse than assumed in all views, no single view is at fault."""
MIN_DEPTH_M = 0.01
"""Minimum distance from the camera of a point that is checked."""
MAX_CHECKED_POINTS = 600
"""Maximum number of points of each view that are checked, evenly spread."""


def find_inconsistent_views(
    clouds: Sequence[NormalCloud], robot_errors: NDArray[np.float64], parameters: ChainParameters
) -> dict[int, str]:
    """Return the views that do not fit the others, each with the reason.

    The view that contradicts the others most is removed first, and the others are then compared again. A single wrong
    view therefore does not make the others inconsistent.

    Args:
        clouds: The views as registered.
        robot_errors: (V,) Mahalanobis norm of the robot error of each view that registration found.
        parameters: Parameters of the method, for the radius r.

    Returns:
        Reason by index of the view; empty if all views are consistent.

    Raises:
        ContradictingViewsError: Half of the views or more would have to be excluded.

    Source:
        Ours.
    """
    violations = free_space_violations(clouds, parameters)
    contradictions = np.maximum(violations, violations.T)
    kept = list(range(len(clouds)))
    reasons: dict[int, str] = {}
    while len(kept) > 1:
        among_kept = contradictions[np.ix_(kept, kept)]
        scores = np.array([_upper_median(np.delete(row, i)) for i, row in enumerate(among_kept)])
        if scores.max() <= MAX_FREE_SPACE_VIOLATION:
            break
        worst = int(np.where(scores > MAX_FREE_SPACE_VIOLATION, among_kept.sum(axis=1), -1.0).argmax())
        reasons[clouds[kept[worst]].view] = (
            f"it contradicts the other views: {scores[worst]:.0%} of the surface in one view is free space in the "
            "other; the pose, the frame or the string has changed"
        )
        del kept[worst]
    if len(kept) <= len(clouds) / 2:
        i, j = divmod(int(contradictions.argmax()), len(clouds))
        raise ContradictingViewsError(
            f"views {clouds[i].view} and {clouds[j].view} contradict each other ({contradictions[i, j]:.0%} of the "
            "surface in one view is free space in the other), and no majority of the views agrees: check that nothing "
            "moved during the scan; if this happens again, check the hand-eye calibration, as the camera may have "
            "moved on the flange"
        )
    median_error = float(np.median(robot_errors[kept]))
    for k in kept if len(kept) > 2 else []:
        if robot_errors[k] > max(MAX_ROBOT_SIGMA, MAX_ROBOT_RATIO * median_error):
            reasons[clouds[k].view] = (
                f"its pose would need a correction of {robot_errors[k]:.0f} sigma of the arm's accuracy (the other "
                f"views: {median_error:.0f}): it was not captured at the pose that the arm reported"
            )
    if len(clouds) - len(reasons) <= len(clouds) / 2:
        raise ContradictingViewsError(
            f"{len(reasons)} of {len(clouds)} views would have to be excluded, and no majority of the views agrees: "
            f"{'; '.join(f'view {view}: {reason}' for view, reason in reasons.items())}; check the poses and the arm"
        )
    return reasons


def free_space_violations(clouds: Sequence[NormalCloud], parameters: ChainParameters) -> NDArray[np.float64]:
    """Return the share of each view's surface that lies in the free space of each other view.

    A point lies in the free space of a view if that view measured something more than r behind it.

    Args:
        clouds: The V views as registered.
        parameters: Parameters of the method, for the radius r.

    Returns:
        (V, V) share, 0 to 1: row i is the view that sees through, column j the view whose surface is checked. Zero if
        view i has no depth image or sees nothing of that surface.
    """
    n_views = len(clouds)
    anchors = [anchor_points(cloud, MAX_CHECKED_POINTS) for cloud in clouds]
    points = np.vstack([cloud.points[chosen] for cloud, chosen in zip(clouds, anchors, strict=True)])
    normals = np.vstack([cloud.normals[chosen] for cloud, chosen in zip(clouds, anchors, strict=True)])
    view = np.repeat(np.arange(n_views), [len(chosen) for chosen in anchors])
    result = np.zeros((n_views, n_views))
    for i, cloud in enumerate(clouds):
        checked, violating = _check_points(cloud, points, normals, parameters.r)
        n_checked = np.bincount(view[checked], minlength=n_views)
        result[i] = np.bincount(view[violating], minlength=n_views) / np.maximum(n_checked, 1)
        result[i, i] = 0.0
    return result


def _check_points(
    cloud: NormalCloud, points: NDArray[np.float64], normals: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of the points (N, 3) that the view can check, and of those in its free space."""
    if cloud.image is None or cloud.T_base_camera is None:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    T, K, depth = cloud.T_base_camera, cloud.image.K, cloud.image.depth
    rays = points - T[:3, 3]
    is_facing = -np.einsum("ij,ij->i", rays, normals) > MIN_FACING_COSINE * np.sqrt(np.einsum("ij,ij->i", rays, rays))
    in_camera = rays @ T[:3, :3]
    visible = np.flatnonzero(is_facing & (in_camera[:, 2] > MIN_DEPTH_M))
    x, y, z = in_camera[visible].T
    # Where r spans few pixels, flying pixels narrow the string in the depth image: a pixel beside it counts as string.
    ring_radius = np.maximum(radius, MIN_RING_PIXELS * z / K[0, 0])
    dx, dy = np.array([(0.0, 0.0), *RING_DIRECTIONS]).T[:, :, None] * ring_radius
    u = (x + dx) / z * K[0, 0] + K[0, 2] + 0.5
    v = (y + dy) / z * K[1, 1] + K[1, 2] + 0.5
    is_inside = (u >= 0) & (u < depth.shape[1]) & (v >= 0) & (v < depth.shape[0])
    measured_z = np.zeros(u.shape)
    measured_z[is_inside] = depth[v[is_inside].astype(np.intp), u[is_inside].astype(np.intp)] * cloud.image.depth_unit_m
    is_measured = measured_z > 0
    is_checked = is_measured[0] & (is_measured.sum(axis=0) >= MIN_MEASURED)
    is_free = is_checked & (~is_measured | (measured_z > z + radius)).all(axis=0)
    return visible[is_checked], visible[is_free]


def _upper_median(values: NDArray[np.float64]) -> float:
    """Return the median; for an even number of values, the larger of the middle two."""
    return float(np.sort(values)[len(values) // 2]) if len(values) else 0.0
