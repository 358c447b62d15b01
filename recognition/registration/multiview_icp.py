"""Joint ICP of all views: least squares over all overlapping surfaces, with a prior on the poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import pose_from_twist
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correlated_errors import pose_covariance
from recognition.registration.correspondences import MAX_ANCHORS, Correspondences, anchor_points, find_correspondences
from recognition.registration.pose_prior import N_SHARED, PosePrior


class SearchSettings(NamedTuple):
    """Settings of the correspondence search in one ICP pass. `find_correspondences` explains them."""

    max_distance_radii: float
    """Maximum distance between two corresponding points, in radii r."""
    min_cosine: float
    """Minimum cosine of the angle between the normals of two corresponding points."""
    max_anchors: int
    """Maximum number of source points for which a match is searched in a target view."""


TUKEY_CONSTANT = 4.685
"""Constant of the Tukey weight, in sigmas: larger residuals have no weight (95 % efficiency for Gaussian errors)."""
MIN_SIGMA_M = 0.0001
"""Minimum standard deviation of the residuals, metres."""
INDEPENDENT_SHARE = 0.05
"""Assumed share of independent points in a view, because depth errors of neighbouring pixels are correlated. With this
share, the covariance of the registered poses predicts their errors on simulated scans."""
COARSE_SEARCH = SearchSettings(max_distance_radii=0.7, min_cosine=0.7, max_anchors=150)
"""Search of the coarse passes, in which the views still move. The first pass uses the given correspondences."""
MAX_COARSE_PASSES = 6
"""Maximum number of coarse passes after the first pass."""
FINE_SEARCH = SearchSettings(max_distance_radii=0.35, min_cosine=0.8, max_anchors=MAX_ANCHORS)
"""Search of the last pass. Points that remain far apart after convergence are not on the same surface."""
CONVERGED_M = 0.0004
"""The poses have converged if a pass moves the points by less than this on average."""
N_REWEIGHTINGS = 2
"""Number of iterations of reweighted least squares in a pass."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Maximum a posteriori poses of V views."""

    twists: NDArray[np.float64]
    """(V, 6) correction of each view, rotation (rad) about the centre, then translation (m)."""
    covariance: NDArray[np.float64]
    """(6 V, 6 V) covariance of the twists."""
    hand_eye_error: NDArray[np.float64]
    """(6,) hand-eye error that all views share, rotation (rad), then translation (m), camera frame."""
    hand_eye_information: NDArray[np.float64] | None
    """(6, 6) information matrix of the hand-eye error, including the prior; None if the given poses were kept."""
    robot_errors: NDArray[np.float64]
    """(V,) Mahalanobis norm of the 6D robot error of each view."""


@dataclass(frozen=True, eq=False)
class _LinearResiduals:
    """Linearised distances `residual + J (x_source - x_target)` of M point pairs, where x is the twist of a view."""

    overlaps: tuple[tuple[int, int, slice], ...]
    """List index of the source view, list index of the target view, and rows of the point pairs, for each overlap."""
    J: NDArray[np.float64]
    """(M, 6) Jacobian with respect to the twist of the source view."""
    residual: NDArray[np.float64]
    """(M,) signed distances at the zero state, metres."""
    share: NDArray[np.float64]
    """(M,) weight factor of each distance, because depth errors are correlated."""

    def evaluate(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signed distances (M,) at `state`, metres."""
        twists = _view_twists(state)
        changes = [self.J[rows] @ (twists[i] - twists[j]) for i, j, rows in self.overlaps]
        return self.residual + np.concatenate(changes)


def align_views(
    clouds: Sequence[NormalCloud],
    correspondences: Sequence[Correspondences],
    is_compared: NDArray[np.bool_],
    centre: NDArray[np.float64],
    prior: PosePrior,
    parameters: ChainParameters,
) -> Alignment:
    """Estimate the poses that minimise the distances between all overlapping views and the cost of the prior.

    The distance of a point pair is measured along the mean of the two normals. On a cylinder, this distance does not
    depend on where the two points lie along or around the cylinder. Tukey weights reduce the effect of outliers. The
    prior determines motions that no surface constrains, for example along a straight string. If the surfaces are not
    closer than at the given poses, the given poses are kept.

    Args:
        clouds: The V views at the given poses, base frame.
        correspondences: Correspondences of the first pass.
        is_compared: (V, V) mask of the views that are compared with each other, from `compared_views`.
        centre: (3,) point about which the corrections rotate, metres, base frame.
        prior: Prior of the state, about the same centre.
        parameters: Method parameters; uses the radius r.

    Returns:
        The pose corrections with their covariance.

    Source:
        Replaces the pairwise ICP of section II.E.
    """
    given_state = np.zeros(len(prior.gradient))
    state = np.asarray(-np.linalg.solve(prior.information, prior.gradient), dtype=np.float64)
    information = prior.information
    is_improved = False
    current = list(correspondences)
    if current:
        given_residuals = _linearise(clouds, current, is_compared, given_state, centre)
        previous, (state, information) = given_state, _solve_reweighted(given_residuals, state, prior)
        for _ in range(MAX_COARSE_PASSES):
            if _mean_displacement(clouds, state - previous, centre) < CONVERGED_M:
                break
            current = _search_all(clouds, is_compared, state, centre, parameters, COARSE_SEARCH) or current
            residuals = _linearise(clouds, current, is_compared, state, centre)
            previous, (state, information) = state, _solve_reweighted(residuals, state, prior)
        current = _search_all(clouds, is_compared, state, centre, parameters, FINE_SEARCH) or current
        residuals = _linearise(clouds, current, is_compared, state, centre)
        state, information = _solve_reweighted(residuals, state, prior)
        n_searched = sum(overlap.n_searched for overlap in correspondences)
        given_distance = _mean_surface_distance(given_residuals, given_state, correspondences, n_searched, parameters)
        distance = _mean_surface_distance(residuals, state, current, n_searched, parameters)
        is_improved = distance <= given_distance
        if not is_improved:
            state, information = given_state, prior.information
    return Alignment(
        twists=_view_twists(state),
        covariance=pose_covariance(state, information, prior, [cloud.T_base_camera for cloud in clouds]),
        hand_eye_error=state[-N_SHARED:-1],
        hand_eye_information=_marginal_hand_eye_information(information) if is_improved else None,
        robot_errors=np.array([float(np.linalg.norm(D @ state + d)) for D, d in prior.robot_errors]),
    )


def correction_transforms(twists: NDArray[np.float64], centre: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Convert the twists of V views to transforms.

    Args:
        twists: (V, 6) rotation (rad) about the centre, then translation (m).
        centre: (3,) point about which the corrections rotate, metres, base frame.

    Returns:
        V transforms (4, 4), base to base.
    """
    T = pose_from_twist(twists)
    T[:, :3, 3] = centre + twists[:, 3:] - T[:, :3, :3] @ centre
    return list(T)


def _view_twists(state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the twists (V, 6) of the views from the state (6 V + 7,)."""
    return state[:-N_SHARED].reshape(-1, 6)


def _marginal_hand_eye_information(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the information matrix (6, 6) of the hand-eye error, marginalised over the rest of the state."""
    own = np.arange(len(information) - N_SHARED, len(information) - 1)
    rest = np.delete(np.arange(len(information)), own)
    between = information[np.ix_(rest, own)]
    return information[np.ix_(own, own)] - between.T @ np.linalg.solve(information[np.ix_(rest, rest)], between)


def _search_all(
    clouds: Sequence[NormalCloud],
    is_compared: NDArray[np.bool_],
    state: NDArray[np.float64],
    centre: NDArray[np.float64],
    parameters: ChainParameters,
    search: SearchSettings,
) -> list[Correspondences]:
    """Return the correspondences of each view with the earlier views that it is compared with, at `state`."""
    T = correction_transforms(_view_twists(state), centre)
    found: list[Correspondences] = []
    for k, cloud in enumerate(clouds):
        earlier = np.flatnonzero(is_compared[k, :k]).tolist()
        others, T_others = [clouds[j] for j in earlier], [T[j] for j in earlier]
        found += find_correspondences(cloud, others, parameters, *search, T[k], T_others)
    return found


def _linearise(
    clouds: Sequence[NormalCloud],
    correspondences: Sequence[Correspondences],
    is_compared: NDArray[np.bool_],
    state: NDArray[np.float64],
    centre: NDArray[np.float64],
) -> _LinearResiduals:
    """Linearise the distances of all point pairs at `state`."""
    T = correction_transforms(_view_twists(state), centre)
    position = {cloud.view: k for k, cloud in enumerate(clouds)}
    row_ends = np.cumsum([0, *(len(overlap.source_indices) for overlap in correspondences)])
    overlaps = tuple(
        (position[overlap.source_view], position[overlap.target_view], slice(int(first), int(end)))
        for overlap, first, end in zip(correspondences, row_ends[:-1], row_ends[1:], strict=True)
    )
    paired = list(zip(overlaps, correspondences, strict=True))
    source = np.vstack([_move(clouds[i], overlap.source_indices, T[i], centre) for (i, _, _), overlap in paired])
    target = np.vstack([_move(clouds[j], overlap.target_indices, T[j], centre) for (_, j, _), overlap in paired])
    normal = source[:, 3:] + target[:, 3:]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    (x, y, z), (n_x, n_y, n_z) = (source[:, :3] + target[:, :3]).T / 2, normal.T
    J = np.column_stack([y * n_z - z * n_y, z * n_x - x * n_z, x * n_y - y * n_x, normal])
    # The errors of a view enter all its overlaps. Among d partners, each overlap therefore has the share 1 / (d + 1) of
    # each of its two views. If all V views are compared with each other, this is 2 / V.
    view_share = 1 / (1 + is_compared.sum(axis=1))
    shares = [
        min(INDEPENDENT_SHARE * len(clouds[i].points) / overlap.n_searched, 1.0) * (view_share[i] + view_share[j])
        for (i, j, _), overlap in paired
    ]
    share = np.repeat(shares, np.diff(row_ends))
    change = _LinearResiduals(overlaps, J, np.zeros(len(J)), share).evaluate(state)
    residual = np.einsum("ij,ij->i", source[:, :3] - target[:, :3], normal) - change
    return _LinearResiduals(overlaps, J, residual, share)


def _move(
    cloud: NormalCloud, indices: NDArray[np.intp], T: NDArray[np.float64], centre: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the moved points, from `centre`, and their moved normals (M, 6)."""
    # `take` copies rows several times faster than indexing.
    points, normals = cloud.points.take(indices, axis=0), cloud.normals.take(indices, axis=0)
    return np.hstack([points @ T[:3, :3].T + (T[:3, 3] - centre), normals @ T[:3, :3].T])


def _solve_reweighted(
    residuals: _LinearResiduals, state: NDArray[np.float64], prior: PosePrior
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the state and its information matrix by iteratively reweighted least squares on fixed point pairs."""
    information = prior.information
    for _ in range(N_REWEIGHTINGS):
        distance = residuals.evaluate(state)
        sigma = max(1.4826 * float(np.median(np.abs(distance))), MIN_SIGMA_M)
        weight = np.clip(1 - (distance / (TUKEY_CONSTANT * sigma)) ** 2, 0, 1) ** 2 * (residuals.share / sigma**2)
        weighted_J = residuals.J * weight[:, None]
        row_gradients = weighted_J * distance[:, None]
        information, gradient = prior.information.copy(), prior.gradient + prior.information @ state
        for i, j, rows in residuals.overlaps:
            source, target = slice(6 * i, 6 * i + 6), slice(6 * j, 6 * j + 6)
            H, g = weighted_J[rows].T @ residuals.J[rows], row_gradients[rows].sum(axis=0)
            information[source, source] += H
            information[target, target] += H
            information[source, target] -= H
            information[target, source] -= H
            gradient[source] += g
            gradient[target] -= g
        state = np.asarray(state - np.linalg.solve(information, gradient), dtype=np.float64)
    return state, information


def _mean_surface_distance(
    residuals: _LinearResiduals,
    state: NDArray[np.float64],
    correspondences: Sequence[Correspondences],
    n_searched: int,
    parameters: ChainParameters,
) -> float:
    """Return the mean distance between the surfaces over `n_searched` points, metres.

    Only pairs that the fine search accepts are used. A point without such a pair has the maximum distance of the fine
    search. `n_searched` is the number of source points in the first pass, so a view cannot reduce the mean by moving
    away from the others.
    """
    max_distance = FINE_SEARCH.max_distance_radii * parameters.r
    is_accepted = np.concatenate(
        [(overlap.distances < max_distance) & (overlap.cosines > FINE_SEARCH.min_cosine) for overlap in correspondences]
    )
    margin = float(np.maximum(max_distance - np.abs(residuals.evaluate(state)), 0)[is_accepted].sum())
    return max_distance - margin / n_searched


def _mean_displacement(
    clouds: Sequence[NormalCloud], change: NDArray[np.float64], centre: NDArray[np.float64]
) -> float:
    """Return the mean displacement of the points of all views by a change of the state, metres."""
    distances = []
    for k, cloud in enumerate(clouds):
        offsets = cloud.points[anchor_points(cloud, 50)] - centre
        rotation, translation = change[6 * k : 6 * k + 3], change[6 * k + 3 : 6 * k + 6]
        distances.append(np.linalg.norm(np.cross(rotation, offsets) + translation, axis=1))
    return float(np.concatenate(distances).mean())
