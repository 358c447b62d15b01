"""Fitness of registered views: the share of points that lie on the surface of another view."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, rotation_angle, transform_points
from recognition.model.quality import ViewQuality
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import MIN_COSINE, anchor_points

MAX_FITNESS_POINTS = 60
"""Maximum number of anchor points of each view, evenly spread."""
MAX_PARTNERS = 7
"""Maximum number of other views with which a view is compared. The limit keeps the time proportional to the number of
views."""


def evaluate_fitness(
    clouds: Sequence[NormalCloud], registered: Sequence[NormalCloud], parameters: ChainParameters
) -> list[ViewQuality]:
    """Return the fitness of each registered view and the size of its correction.

    An anchor point fits if the nearest point of another view lies within r and has a similar normal. The residual is
    the distance between the two points, along the mean of the two normals.

    Args:
        clouds: Views before registration, base frame.
        registered: The same views after registration, base frame.
        parameters: Method parameters; uses the radius r.

    Returns:
        One item for each view, in the order of `registered`.
    """
    # Move the anchor points to the unregistered clouds, because the search trees of these clouds exist already.
    T_unregistered = [
        cloud.T_correction @ inverse(moved.T_correction) for cloud, moved in zip(clouds, registered, strict=True)
    ]
    qualities = []
    for k, view in enumerate(registered):
        anchors = anchor_points(view, MAX_FITNESS_POINTS)
        points, normals = view.points[anchors], view.normals[anchors]
        nearest_distance, residual = np.full(len(anchors), np.inf), np.zeros(len(anchors))
        for j in _partners(k, len(registered)):
            distance, nearest = clouds[j].tree.query(
                transform_points(T_unregistered[j], points), distance_upper_bound=parameters.r
            )
            nearer = np.flatnonzero(np.asarray(distance) < nearest_distance)
            partner = np.asarray(nearest)[nearer]
            partner_normals = registered[j].normals[partner]
            is_aligned = np.vecdot(normals[nearer], partner_normals) > MIN_COSINE
            nearer, partner, partner_normals = nearer[is_aligned], partner[is_aligned], partner_normals[is_aligned]
            normal = normals[nearer] + partner_normals
            offset = points[nearer] - registered[j].points[partner]
            nearest_distance[nearer] = np.asarray(distance)[nearer]
            residual[nearer] = np.vecdot(offset, normal) / np.sqrt(np.vecdot(normal, normal))
        qualities.append(_view_quality(view, residual[np.isfinite(nearest_distance)], len(anchors)))
    return qualities


def _partners(view: int, n_views: int) -> list[int]:
    """Return the list indices of up to `MAX_PARTNERS` other views, evenly spread."""
    others = [k for k in range(n_views) if k != view]
    return [others[int(k)] for k in np.linspace(0, len(others) - 1, min(MAX_PARTNERS, len(others)))]


def _view_quality(view: NormalCloud, residuals: NDArray[np.float64], n_anchors: int) -> ViewQuality:
    """Return the quality of a view from the residuals of the anchor points that fit."""
    mean_point = view.points.mean(axis=0)
    return ViewQuality(
        index=view.view,
        used=True,
        reason=None,
        points=len(view.points),
        fitness=len(residuals) / n_anchors,
        rms_m=float(np.sqrt(np.mean(residuals**2))) if len(residuals) else None,
        correction_m=float(np.linalg.norm(mean_point - transform_points(inverse(view.T_correction), mean_point))),
        correction_rad=rotation_angle(view.T_correction),
    )
