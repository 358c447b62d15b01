"""How each view fits the others, as registered."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from calibration.transforms import inverse, rotation_angle, transform_points
from recognition.model import ViewQuality
from recognition.normals import NormalCloud
from recognition.overlap import MIN_COSINE, anchors
from recognition.parameters import ChainParameters

JUDGED = 100
"""Points of each view by which its fitness is judged, ..."""
JUDGED_IN_ALL = 2400
"""... but no more than this of all views together: what lies within r of one another is held in memory."""


def fitness(placed: Sequence[NormalCloud], parameters: ChainParameters) -> list[ViewQuality]:
    """For each of the registered clouds, how its anchors lie on those of the others, and how far it was moved.

    An anchor fits where another view has one within r whose normal is alike; how far the nearest such is off is
    measured along the mean of both normals.
    """
    chosen = [anchors(cloud, min(JUDGED, JUDGED_IN_ALL // len(placed))) for cloud in placed]
    points, normals = (
        np.vstack([values[own] for values, own in zip(of_clouds, chosen, strict=True)])
        for of_clouds in ([cloud.points for cloud in placed], [cloud.normals for cloud in placed])
    )
    looked = np.array([len(own) for own in chosen])
    view = np.repeat(np.arange(len(placed)), looked)
    i, j = KDTree(points).query_pairs(parameters.r, output_type="ndarray").T
    i, j = np.concatenate([i, j]), np.concatenate([j, i])
    alike = (view[i] != view[j]) & (np.vecdot(normals[i], normals[j]) > MIN_COSINE)
    i, j = i[alike], j[alike]
    way = points[i] - points[j]
    nearest_first = np.lexsort((np.vecdot(way, way), i))
    nearest = nearest_first[np.diff(i[nearest_first], prepend=-1) > 0]
    i, j, way = i[nearest], j[nearest], way[nearest]
    normal = normals[i] + normals[j]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    fitting = np.bincount(view[i], minlength=len(placed))
    squares = np.bincount(view[i], np.vecdot(way, normal) ** 2, len(placed))
    return [
        _quality(cloud, int(count), int(of), float(square))
        for cloud, count, of, square in zip(placed, fitting, looked, squares, strict=True)
    ]


def _quality(cloud: NormalCloud, fitting: int, looked: int, squares: float) -> ViewQuality:
    middle = cloud.points.mean(axis=0)
    return ViewQuality(
        index=cloud.view,
        used=True,
        reason=None,
        points=len(cloud.points),
        fitness=fitting / looked,
        rms_m=float(np.sqrt(squares / fitting)) if fitting else None,
        correction_m=float(np.linalg.norm(middle - transform_points(inverse(cloud.T_correction), middle))),
        correction_rad=rotation_angle(cloud.T_correction),
    )
