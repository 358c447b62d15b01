"""Whether the views show the same scene: none may see the table where others see the string."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recognition.errors import RecognitionError
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import anchor_points

MAX_SEEN_THROUGH = 0.025
"""Share of other views' surface that a view may see through. Views that agree have none, in the median over their
partners; one that is 20 mm off along a straight string of 0.4 m has 0.035, any other wrong one 0.2 and more."""
FACING = 0.5
"""Only surface that faces the camera is looked at (cosine): what is seen at a glance is measured worst."""
AROUND = tuple((np.cos(k * np.pi / 4), np.sin(k * np.pi / 4)) for k in range(8))
"""A point is seen through if all that is seen within r round it lies behind: a millimetre of pose decides nothing."""
COARSE_PIXELS = 2.0
"""Nor do two pixels, where they are more than r."""
MIN_SEEN = 5
"""Of the nine places, the point's own among them, so many must have been measured."""
MAX_ROBOT_SIGMA = 10.0
"""A view that needs a larger correction than this, of its own and in sigmas, is not where the arm says."""
MAX_ROBOT_RATIO = 3.0
"""It must also be so many times the other views': an arm that is worse than assumed is no view's fault."""
NEAREST_M = 0.01
"""Nothing nearer to a camera than this is looked at."""
_POINTS = 600


class ContradictingViewsError(RecognitionError):
    """The views show different scenes, and no majority of them agrees."""

    slug = "contradicting-views"


def find_inconsistent_views(
    clouds: Sequence[NormalCloud], robot_sigma: NDArray[np.float64], parameters: ChainParameters
) -> dict[int, str]:
    """The views that do not fit the others, each with the reason; `clouds` as registered.

    `robot_sigma` (V,) is how far each view had to be corrected on its own. The view that contradicts most is taken
    out first and the others are asked again, so that one wrong view does not make all others suspect.

    Raises:
        ContradictingViewsError: half of the views or more would have to go.
    """
    through = free_space_violations(clouds, parameters)
    against = np.maximum(through, through.T)
    kept = list(range(len(clouds)))
    reasons: dict[int, str] = {}
    while len(kept) > 1:
        among = against[np.ix_(kept, kept)]
        scores = np.array([_upper_median(np.delete(row, i)) for i, row in enumerate(among)])
        if scores.max() <= MAX_SEEN_THROUGH:
            break
        worst = int(np.where(scores > MAX_SEEN_THROUGH, among.sum(axis=1), -1.0).argmax())
        reasons[clouds[kept[worst]].view] = (
            f"it contradicts the other views: {scores[worst]:.0%} of the surface is where one of two views sees the "
            "table behind; the pose, the frame or the string has changed"
        )
        del kept[worst]
    if len(kept) <= len(clouds) / 2:
        i, j = divmod(int(against.argmax()), len(clouds))
        raise ContradictingViewsError(
            f"views {clouds[i].view} and {clouds[j].view} contradict one another ({against[i, j]:.0%} of the surface "
            "that one sees is where the other sees the table behind), and no majority of views agrees: check that "
            "nothing moved during the scan, and where it comes again the hand-eye calibration: the camera may have "
            "been moved on the flange"
        )
    usual = float(np.median(robot_sigma[kept]))
    for k in kept if len(kept) > 2 else []:
        if robot_sigma[k] > max(MAX_ROBOT_SIGMA, MAX_ROBOT_RATIO * usual):
            reasons[clouds[k].view] = (
                f"to fit the others its pose would have to be corrected by {robot_sigma[k]:.0f} sigma of the arm's "
                f"accuracy (the other views: {usual:.0f}): it was not taken where the arm says"
            )
    if len(clouds) - len(reasons) <= len(clouds) / 2:
        raise ContradictingViewsError(
            f"{len(reasons)} of {len(clouds)} views would have to be left out, and no majority agrees: "
            f"{'; '.join(f'view {view}: {reason}' for view, reason in reasons.items())}; check the poses and the arm"
        )
    return reasons


def free_space_violations(clouds: Sequence[NormalCloud], parameters: ChainParameters) -> NDArray[np.float64]:
    """(V, V) share of the surface of view j that view i sees through: it measured something more than r behind it.

    Zero where a cloud has no depth image, or does not look there.
    """
    count = len(clouds)
    chosen = [anchor_points(cloud, _POINTS) for cloud in clouds]
    points = np.vstack([cloud.points[some] for cloud, some in zip(clouds, chosen, strict=True)])
    normals = np.vstack([cloud.normals[some] for cloud, some in zip(clouds, chosen, strict=True)])
    view = np.repeat(np.arange(count), [len(some) for some in chosen])
    result = np.zeros((count, count))
    for i, cloud in enumerate(clouds):
        judged, through = _through(cloud, points, normals, parameters.r)
        looked_at = np.bincount(view[judged], minlength=count)
        result[i] = np.bincount(view[through], minlength=count) / np.maximum(looked_at, 1)
        result[i, i] = 0.0
    return result


def _through(
    cloud: NormalCloud, points: NDArray[np.float64], normals: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which of the points (N, 3) the view of `cloud` can judge, and which of these it sees through."""
    if cloud.image is None or cloud.T_base_camera is None:
        return np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    T, K, depth = cloud.T_base_camera, cloud.image.K, cloud.image.depth
    way = points - T[:3, 3]
    facing = -np.einsum("ij,ij->i", way, normals) > FACING * np.sqrt(np.einsum("ij,ij->i", way, way))
    local = way @ T[:3, :3]
    judged = np.flatnonzero(facing & (local[:, 2] > NEAREST_M))
    x, y, z = local[judged].T
    # Where a radius is less than the pixels show, rims eat the string: what is beside it then belongs to it.
    reach = np.maximum(radius, COARSE_PIXELS * z / K[0, 0])
    across, down = np.array([(0.0, 0.0), *AROUND]).T[:, :, None] * reach
    u = (x + across) / z * K[0, 0] + K[0, 2] + 0.5
    v = (y + down) / z * K[1, 1] + K[1, 2] + 0.5
    inside = (u >= 0) & (u < depth.shape[1]) & (v >= 0) & (v < depth.shape[0])
    measured = np.zeros(u.shape)
    measured[inside] = depth[v[inside].astype(np.intp), u[inside].astype(np.intp)] * cloud.image.depth_unit_m
    seen = measured > 0
    enough = seen[0] & (seen.sum(axis=0) >= MIN_SEEN)
    through = enough & (~seen | (measured > z + radius)).all(axis=0)
    return judged[enough], judged[through]


def _upper_median(values: NDArray[np.float64]) -> float:
    """The median; of an even number the upper of the two in the middle."""
    return float(np.sort(values)[len(values) // 2]) if len(values) else 0.0
