"""Find views that contradict the other views, by their measured free space and by their robot error.

The free space of a view is the space between the camera and the measured surface. The surface of another view must not
lie in this space.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.errors import ContradictingViewsError, DepthNoiseError
from recognition.model.quality import ExclusionReason
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.table_scatter import NOISE_ADVICE, max_scatter_m
from recognition.registration.correspondences import anchor_points

MAX_FREE_SPACE_VIOLATION = 0.025
"""Maximum share of the surface of one view in the free space of another view, as the median over the other views.

Consistent views have a share of 0. A view with an error of 20 mm along a straight string of 0.4 m has 0.035.
Other wrong views have 0.2 or more.
"""
CONFIDENCE_Z = 1.96
"""Quantile of the normal distribution of the lower confidence bound of a share of points (97.5 %, one-sided)."""
MIN_FACING_COSINE = 0.5
"""Minimum cosine between the surface normal and the direction to the camera. Surface at a grazing angle is not checked,
because its depth is the least accurate."""
RING_DIRECTIONS = tuple((np.cos(k * np.pi / 4), np.sin(k * np.pi / 4)) for k in range(8))
"""Directions of the samples on a ring around a point. The point lies in free space only if the view measured surface
behind all measured samples. A pose error of a millimetre therefore causes no violation."""
MIN_RING_PIXELS = 2.0
"""Minimum radius of the ring, pixels. The radius of the ring is r if r is larger than this in the image."""
NOISE_SIGMAS = 2.5
"""Minimum difference of two depths that shows free space, in sigmas of their difference, if that is more than r."""
MAX_BEHIND_RADII = 2.0
"""Maximum of this difference, in radii r. With more noise, a view does not show whether a string is there."""
MIN_MEASURED = 5
"""Minimum number of samples with a depth, among the nine samples: the point and its ring."""
MAX_ROBOT_SIGMA = 10.0
"""Maximum robot error of a view (Mahalanobis norm). A larger error shows that the reported pose was wrong."""
MAX_ROBOT_RATIO = 3.0
"""Maximum ratio of the robot error of a view to the median over all views. A view is excluded only if it exceeds this
limit and `MAX_ROBOT_SIGMA`. If all views have large errors, the arm is inaccurate, and no single view is wrong."""
MAX_UNDECIDED_VIEWS = 2
"""Maximum number of views of which none is excluded for its robot error."""
MIN_DEPTH_M = 0.01
"""Minimum depth of a point that is checked, metres."""
MAX_CHECKED_POINTS = 600
"""Maximum number of points of each view that are checked in another view, evenly spread."""
MAX_FULL_CHECKS = 7
"""Maximum number of other views in which `MAX_CHECKED_POINTS` are checked. With more views, fewer points are checked in
each, so the time is linear in the number of views. All pairs of views are still checked, because nearest views may
agree although two halves of the views contradict each other, for example after the camera was moved."""
MIN_CHECKED_POINTS = 60
"""Minimum number of points of each view that are checked in another view, however many views exist."""


def find_inconsistent_views(
    clouds: Sequence[NormalCloud],
    robot_errors: NDArray[np.float64],
    parameters: ChainParameters,
    table_z_m: float | None = None,
) -> dict[int, ExclusionReason]:
    """Return the views that contradict the other views, each with the reason.

    The most contradicting view is removed first, and the remaining views are then compared again. A single wrong view
    therefore does not exclude correct views. The share of a pair of views has the weight of its checked points, and the
    lower confidence bound of the share over all pairs must exceed the limit too.

    Args:
        clouds: Registered views, base frame.
        robot_errors: (V,) Mahalanobis norm of the robot error of each view, from registration.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        table_z_m: Height of the table plane, metres, base frame; None if unknown.

    Returns:
        Reasons by view index; empty if all views are consistent.

    Raises:
        ContradictingViewsError: At least half of the views would have to be excluded.
        DepthNoiseError: The same, but the depth scatters so much that noise explains it.
    """
    violations, n_checked = free_space_violations(clouds, parameters, table_z_m)
    contradictions, n_compared = _contradictions(violations, n_checked)
    contradicting = _find_contradicting(contradictions, n_compared)
    kept = [k for k in range(len(clouds)) if k not in contradicting]
    if len(kept) <= len(clouds) / 2:
        _raise_if_noisy(clouds, parameters)
        i, j = divmod(int(contradictions.argmax()), len(clouds))
        raise ContradictingViewsError(
            f"views {clouds[i].view} and {clouds[j].view} contradict each other ({contradictions[i, j]:.0%} of the "
            "surface in one view is free space in the other), and no majority of the views agrees: check that the "
            f"radius of {parameters.r * 1000:.1f} mm is not too small, and that nothing moved during the scan; if this "
            "happens again, check the hand-eye calibration, as the camera may have moved on the flange"
        )
    found = contradicting | _find_wrong_poses(robot_errors, kept)
    reasons = {clouds[k].view: reason for k, reason in found.items()}
    if len(clouds) - len(reasons) <= len(clouds) / 2:
        _raise_if_noisy(clouds, parameters)
        details = "; ".join(f"view {view}: {reason.message}" for view, reason in reasons.items())
        raise ContradictingViewsError(
            f"{len(reasons)} of {len(clouds)} views would have to be excluded, and no majority of the views agrees: "
            f"{details}; check the poses and the arm"
        )
    return reasons


def _find_contradicting(
    contradictions: NDArray[np.float64], n_compared: NDArray[np.int64]
) -> dict[int, ExclusionReason]:
    """Return the reason of each view that contradicts the others, by list index, the most contradicting one first.

    `contradictions` (V, V) are the shares of the surface, and `n_compared` (V, V) the numbers of points.
    """
    kept = list(range(len(contradictions)))
    reasons = {}
    while len(kept) > 1:
        among_kept = contradictions[np.ix_(kept, kept)]
        scores = _view_scores(among_kept, n_compared[np.ix_(kept, kept)])
        is_contradicting = scores > MAX_FREE_SPACE_VIOLATION
        if not is_contradicting.any():
            break
        worst = int(np.where(is_contradicting, among_kept.sum(axis=1), -1.0).argmax())
        reasons[kept[worst]] = ExclusionReason(
            "view-contradicting",
            f"it contradicts the other views: {scores[worst]:.0%} of the surface in one view is free space in the "
            "other; the pose, the frame or the string has changed",
        )
        del kept[worst]
    return reasons


def _find_wrong_poses(robot_errors: NDArray[np.float64], kept: Sequence[int]) -> dict[int, ExclusionReason]:
    """Return the reason of each of the `kept` views with a large robot error, by list index."""
    # Two views share their difference equally, so neither of them is the wrong one.
    if len(kept) <= MAX_UNDECIDED_VIEWS:
        return {}
    median_error = float(np.median(robot_errors[kept]))
    max_error = max(MAX_ROBOT_SIGMA, MAX_ROBOT_RATIO * median_error)
    reasons = {}
    for k in kept:
        if robot_errors[k] > max_error:
            reasons[k] = ExclusionReason(
                "view-pose-error",
                f"its pose would need a correction of {robot_errors[k]:.0f} sigma of the arm's accuracy (the other "
                f"views: {median_error:.0f}): it was not captured at the pose that the arm reported",
            )
    return reasons


def free_space_violations(
    clouds: Sequence[NormalCloud], parameters: ChainParameters, table_z_m: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the share of the surface of each view that lies in the free space of each other view.

    A point lies in the free space of a view if the view measured surface more than r behind the point, or more than
    `NOISE_SIGMAS` of its noise. The same must hold for all measured samples on the ring around the point.

    Args:
        clouds: The V registered views, base frame.
        parameters: Method parameters; uses the radius r and the height threshold z_t.
        table_z_m: Height of the table plane, metres, base frame. A depth more than z_t below it is an error and shows
            no free space. None: every depth counts.

    Returns:
        Shares (V, V), 0 to 1, and the numbers (V, V) of points that they are taken from. Entry (i, j) is the share of
        the checked surface of view j in the free space of view i. It is zero if view i has no depth image, or if view i
        does not see the surface of view j.
    """
    n_views = len(clouds)
    n_checks = max(n_views - 1, MAX_FULL_CHECKS)
    n_checked_points = max(MAX_CHECKED_POINTS * MAX_FULL_CHECKS // n_checks, MIN_CHECKED_POINTS)
    anchors = [anchor_points(cloud, n_checked_points) for cloud in clouds]
    points = np.vstack([cloud.points[chosen] for cloud, chosen in zip(clouds, anchors, strict=True)])
    normals = np.vstack([cloud.normals[chosen] for cloud, chosen in zip(clouds, anchors, strict=True)])
    view = np.repeat(np.arange(n_views), [len(chosen) for chosen in anchors])
    min_z_m = -np.inf
    if table_z_m is not None:
        min_z_m = table_z_m - parameters.z_t
    n_violating, n_checked = np.zeros((2, n_views, n_views), dtype=np.int64)
    for i, cloud in enumerate(clouds):
        checked, violating = _check_points(cloud, points, normals, parameters.r, min_z_m)
        n_checked[i] = np.bincount(view[checked], minlength=n_views)
        n_violating[i] = np.bincount(view[violating], minlength=n_views)
    np.fill_diagonal(n_checked, 0)
    np.fill_diagonal(n_violating, 0)
    return n_violating / np.maximum(n_checked, 1), n_checked


def _contradictions(
    violations: NDArray[np.float64], n_checked: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the larger share of each pair of views (V, V), and the number of points (V, V) that it is taken from."""
    is_larger = (violations > violations.T) | ((violations == violations.T) & (n_checked >= n_checked.T))
    return np.maximum(violations, violations.T), np.where(is_larger, n_checked, n_checked.T)


def _view_scores(shares: NDArray[np.float64], n_checked: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the score (V,) of each view: the weighted median of its shares, or the bound over all if that is less.

    The weights of the shares (V, V) are their numbers of checked points (V, V), because few points say little.
    """
    scores = np.empty(len(shares))
    for k, (row, weight) in enumerate(zip(shares, n_checked, strict=True)):
        bound = _lower_bound(float(row @ weight), int(weight.sum()))
        scores[k] = min(_upper_median(row, weight), bound)
    return scores


def _lower_bound(count: float, n: int) -> float:
    """Return the lower confidence bound of a share that was measured as `count` of `n` points (Wilson score)."""
    if n == 0:
        return 0.0
    share = count / n
    z2 = CONFIDENCE_Z**2
    margin = CONFIDENCE_Z * float(np.sqrt(share * (1 - share) / n + z2 / (4 * n**2)))
    return (share + z2 / (2 * n) - margin) / (1 + z2 / n)


def _raise_if_noisy(clouds: Sequence[NormalCloud], parameters: ChainParameters) -> None:
    """Raise DepthNoiseError if the depth scatters so much that it explains why views contradict each other."""
    scatter_m = float(np.median([cloud.scatter.pixel_m for cloud in clouds]))
    limit_m = max_scatter_m(parameters)
    if scatter_m > limit_m:
        raise DepthNoiseError(
            f"the depth of the table scatters by {scatter_m * 1000:.1f} mm (one sigma, median of {len(clouds)} views), "
            f"and the views contradict each other. With more than {limit_m * 1000:.1f} mm, two views can differ by the "
            f"string radius of {parameters.r * 1000:.1f} mm although nothing moved. {NOISE_ADVICE}"
        )


def _check_points(
    cloud: NormalCloud, points: NDArray[np.float64], normals: NDArray[np.float64], radius: float, min_z_m: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of the points (N, 3) that the view can check, and of the points in its free space.

    Depths below the height `min_z_m` count as not measured.
    """
    if cloud.image is None or cloud.T_base_camera is None:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    T = cloud.T_base_camera
    K = cloud.image.K
    depth = cloud.image.depth
    rays = points - T[:3, 3]
    is_facing = -np.einsum("ij,ij->i", rays, normals) > MIN_FACING_COSINE * np.sqrt(np.einsum("ij,ij->i", rays, rays))
    in_camera = rays @ T[:3, :3]
    visible = np.flatnonzero(is_facing & (in_camera[:, 2] > MIN_DEPTH_M))
    x, y, z = in_camera[visible].T
    noise_m = NOISE_SIGMAS * float(np.sqrt(2)) * cloud.scatter.pixel_m
    behind_m = float(np.clip(noise_m, radius, MAX_BEHIND_RADII * radius))
    # If r spans few pixels, flying pixels narrow the string in the depth image. The ring is then larger.
    ring_radius = np.maximum(radius, MIN_RING_PIXELS * z / K[0, 0])
    dx, dy = np.array([(0.0, 0.0), *RING_DIRECTIONS]).T[:, :, None] * ring_radius
    # The samples (9, M): the first row is the points themselves.
    sample_x = x + dx
    sample_y = y + dy
    u = sample_x / z * K[0, 0] + K[0, 2] + 0.5
    v = sample_y / z * K[1, 1] + K[1, 2] + 0.5
    height, width = depth.shape
    is_inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    row = np.where(is_inside, v, 0).astype(np.intp)
    column = np.where(is_inside, u, 0).astype(np.intp)
    measured_z = depth.take(row * width + column) * cloud.image.depth_unit_m * is_inside
    is_measured = measured_z > 0
    if np.isfinite(min_z_m):
        a, b, c = T[2, :3]
        is_measured &= T[2, 3] + measured_z * (a * sample_x / z + b * sample_y / z + c) > min_z_m
    is_checked = is_measured[0] & (is_measured.sum(axis=0) >= MIN_MEASURED)
    is_free = is_checked & (~is_measured | (measured_z > z + behind_m)).all(axis=0)
    return visible[is_checked], visible[is_free]


def _upper_median(values: NDArray[np.float64], weights: NDArray[np.int64]) -> float:
    """Return the weighted median; between two values, the larger one."""
    if weights.sum() == 0:
        return 0.0
    order = np.argsort(values)
    middle = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2, side="right")
    return float(values[order][middle])
