"""How each view fits the others, as registered."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, rotation_angle, transform_points
from recognition.model.model import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import MIN_COSINE, anchor_points

JUDGED = 60
"""Points of each view by which its fitness is judged."""
PARTNERS = 7
"""Other views in which they are looked for; of more, so many evenly spread: time then grows with the number of views
and not with its square."""


def evaluate_fitness(
    clouds: Sequence[NormalCloud], placed: Sequence[NormalCloud], parameters: ChainParameters
) -> list[ViewQuality]:
    """For each view, how its anchors lie on the other views' surfaces, and how far it was moved.

    `clouds` are the views as they came and `placed` as registered. An anchor fits where another view has a point
    within r whose normal is alike; how far it is from the nearest such is measured along the mean of both normals.
    """
    # The clouds' trees stay where they were built: anchors are brought there.
    back = [cloud.T_correction @ inverse(there.T_correction) for cloud, there in zip(clouds, placed, strict=True)]
    qualities = []
    for k, view in enumerate(placed):
        own = anchor_points(view, JUDGED)
        points, normals = view.points[own], view.normals[own]
        distance, apart = np.full(len(own), np.inf), np.zeros(len(own))
        for j in _partners(k, len(placed)):
            found, nearest = clouds[j].tree.query(transform_points(back[j], points), distance_upper_bound=parameters.r)
            near = np.flatnonzero(np.asarray(found) < distance)
            other = np.asarray(nearest)[near]
            there = placed[j].normals[other]
            alike = np.vecdot(normals[near], there) > MIN_COSINE
            near, other, there = near[alike], other[alike], there[alike]
            normal = normals[near] + there
            way = points[near] - placed[j].points[other]
            distance[near] = np.asarray(found)[near]
            apart[near] = np.vecdot(way, normal) / np.sqrt(np.vecdot(normal, normal))
        qualities.append(_quality(view, apart[np.isfinite(distance)], len(own)))
    return qualities


def _partners(view: int, count: int) -> list[int]:
    """Up to `PARTNERS` of the other views, evenly spread."""
    others = [k for k in range(count) if k != view]
    return [others[int(k)] for k in np.linspace(0, len(others) - 1, min(PARTNERS, len(others)))]


def _quality(view: NormalCloud, apart: NDArray[np.float64], looked: int) -> ViewQuality:
    middle = view.points.mean(axis=0)
    return ViewQuality(
        index=view.view,
        used=True,
        reason=None,
        points=len(view.points),
        fitness=len(apart) / looked,
        rms_m=float(np.sqrt(np.mean(apart**2))) if len(apart) else None,
        correction_m=float(np.linalg.norm(middle - transform_points(inverse(view.T_correction), middle))),
        correction_rad=rotation_angle(view.T_correction),
    )
