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
        One item for each view, in the order of `registered`. A single view has no fitness.
    """
    # Move the anchor points to the unregistered clouds, because the search trees of these clouds exist already.
    T_unregistered = [
        cloud.T_correction @ inverse(moved.T_correction) for cloud, moved in zip(clouds, registered, strict=True)
    ]
    anchors = [anchor_points(view, MAX_FITNESS_POINTS) for view in registered]
    ends = np.cumsum([len(chosen) for chosen in anchors])
    points = np.vstack([view.points[chosen] for view, chosen in zip(registered, anchors, strict=True)])
    normals = np.vstack([view.normals[chosen] for view, chosen in zip(registered, anchors, strict=True)])
    is_partner = _partners(len(registered))
    n_anchors = np.diff(ends, prepend=0)
    nearest_distance = np.full(len(points), np.inf)
    residual = np.zeros(len(points))
    for j, other in enumerate(registered):
        # One search for the anchor points of all views that are compared with view j.
        compared = np.flatnonzero(np.repeat(is_partner[:, j], n_anchors))
        unregistered = transform_points(T_unregistered[j], points[compared])
        distance, nearest = clouds[j].tree.query(unregistered, distance_upper_bound=parameters.r)
        is_nearer = np.asarray(distance) < nearest_distance[compared]
        nearer = compared[is_nearer]
        distance = np.asarray(distance)[is_nearer]
        partner = np.asarray(nearest)[is_nearer]
        is_aligned = np.vecdot(normals[nearer], other.normals[partner]) > MIN_COSINE
        fitting = nearer[is_aligned]
        partner = partner[is_aligned]
        normal = normals[fitting] + other.normals[partner]
        offset = points[fitting] - other.points[partner]
        nearest_distance[fitting] = distance[is_aligned]
        residual[fitting] = np.vecdot(offset, normal) / np.sqrt(np.vecdot(normal, normal))
    # A single view is compared with no other one.
    n_compared = n_anchors * (len(registered) > 1)
    qualities = []
    for k, view in enumerate(registered):
        own = slice(ends[k] - n_anchors[k], ends[k])
        residuals = residual[own][np.isfinite(nearest_distance[own])]
        qualities.append(_view_quality(view, residuals, int(n_compared[k])))
    return qualities


def _partners(n_views: int) -> NDArray[np.bool_]:
    """Return the mask (V, V) of up to `MAX_PARTNERS` other views for each view, evenly spread."""
    is_partner = np.zeros((n_views, n_views), dtype=np.bool_)
    for view in range(n_views):
        others = np.delete(np.arange(n_views), view)
        chosen = np.linspace(0, len(others) - 1, min(MAX_PARTNERS, len(others))).astype(np.intp)
        is_partner[view, others[chosen]] = True
    return is_partner


def _view_quality(view: NormalCloud, residuals: NDArray[np.float64], n_compared: int) -> ViewQuality:
    """Return the quality of a view from the residuals of the fitting ones of `n_compared` anchor points."""
    fitness = None
    if n_compared:
        fitness = len(residuals) / n_compared
    rms_m = None
    if len(residuals):
        rms_m = float(np.sqrt(np.mean(residuals**2)))
    mean_point = view.points.mean(axis=0)
    given_point = transform_points(inverse(view.T_correction), mean_point)
    return ViewQuality(
        index=view.view,
        used=True,
        reason=None,
        points=len(view.points),
        fitness=fitness,
        rms_m=rms_m,
        correction_m=float(np.linalg.norm(mean_point - given_point)),
        correction_rad=rotation_angle(view.T_correction),
    )
