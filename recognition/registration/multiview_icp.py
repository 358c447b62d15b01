"""Joint ICP of all views: least squares over all overlapping surfaces, with a prior on the poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import pose_from_twist
from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.preprocessing.plane_fit import median_sigma
from recognition.registration.correlated_errors import pose_covariance
from recognition.registration.correspondences import (
    MAX_ANCHORS,
    ComparedViews,
    Correspondences,
    anchor_points,
    find_correspondences,
)
from recognition.registration.pose_prior import N_DISPARITY, N_SHARED, PosePrior, twist_entries


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
DISPLACEMENT_POINTS = 50
"""Maximum number of points of each view whose displacement is averaged."""
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


@dataclass(frozen=True)
class _Overlap:
    """Point pairs of two views."""

    source: int
    """List index of the source view."""
    target: int
    """List index of the target view."""
    rows: slice
    """Rows of the point pairs."""


@dataclass(frozen=True, eq=False)
class _LinearResiduals:
    """Linearised distances `residual + J (x_source - x_target)` of M point pairs, where x is the twist of a view."""

    overlaps: tuple[_Overlap, ...]
    """Overlaps of two views, in the order of their rows."""
    J: NDArray[np.float64]
    """(M, 6) Jacobian with respect to the twist of the source view."""
    residual: NDArray[np.float64]
    """(M,) signed distances at the zero state, metres."""
    share: NDArray[np.float64]
    """(M,) weight factor of each distance, because depth errors are correlated."""

    def evaluate(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signed distances (M,) at `state`, metres."""
        twists = _view_twists(state)
        changes = [self.J[pairs.rows] @ (twists[pairs.source] - twists[pairs.target]) for pairs in self.overlaps]
        return self.residual + np.concatenate(changes)


@dataclass(frozen=True, eq=False)
class _Estimate:
    """Estimate of the state."""

    state: NDArray[np.float64]
    """(6 V + 9,) state."""
    information: NDArray[np.float64]
    """(6 V + 9, 6 V + 9) information matrix of the state."""
    is_improved: bool
    """Whether surfaces determined the state; False if only the prior did."""


@dataclass(frozen=True, eq=False)
class _Problem:
    """The views to align, and how their point pairs depend on the state."""

    views: ComparedViews
    """The V views."""
    centre: NDArray[np.float64]
    """(3,) point about which the corrections rotate, metres, base frame."""
    parameters: ChainParameters
    """Method parameters; uses the radius r."""

    @property
    def clouds(self) -> Sequence[NormalCloud]:
        """Clouds of the views at the given poses, base frame."""
        return self.views.clouds

    @cached_property
    def view_share(self) -> NDArray[np.float64]:
        """(V,) share of the errors of each view that each of its overlaps has.

        The errors of a view enter all its overlaps. Among d partners, each overlap therefore has the share 1 / (d + 1)
        of each of its two views. If all V views are compared with each other, the two shares are 2 / V.
        """
        return 1 / (1 + self.views.is_compared.sum(axis=1))

    def corrections(self, state: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Return the correction (4, 4) of each view at `state`, base to base."""
        return correction_transforms(_view_twists(state), self.centre)

    def search(self, state: NDArray[np.float64], settings: SearchSettings) -> list[Correspondences]:
        """Return the correspondences of each view with the earlier views that it is compared with, at `state`."""
        T = self.corrections(state)
        found: list[Correspondences] = []
        for k, cloud in enumerate(self.clouds):
            earlier = np.flatnonzero(self.views.is_compared[k, :k]).tolist()
            others = [self.clouds[j] for j in earlier]
            T_others = [T[j] for j in earlier]
            found += find_correspondences(cloud, others, self.parameters, *settings, T=T[k], T_others=T_others)
        return found

    def linearise(self, correspondences: Sequence[Correspondences], state: NDArray[np.float64]) -> _LinearResiduals:
        """Linearise the distances of all point pairs at `state`."""
        position = {cloud.view: k for k, cloud in enumerate(self.clouds)}
        row_ends = np.cumsum([0, *(len(found.source_indices) for found in correspondences)])
        overlaps = tuple(
            _Overlap(position[found.source_view], position[found.target_view], slice(int(first), int(end)))
            for found, first, end in zip(correspondences, row_ends[:-1], row_ends[1:], strict=True)
        )
        T = self.corrections(state)
        source = []
        target = []
        shares = []
        for pairs, found in zip(overlaps, correspondences, strict=True):
            source.append(self._move(pairs.source, found.source_indices, T[pairs.source]))
            target.append(self._move(pairs.target, found.target_indices, T[pairs.target]))
            shares.append(self._weight_share(pairs, found.n_searched))
        source_points, source_normals = np.hsplit(np.vstack(source), 2)
        target_points, target_normals = np.hsplit(np.vstack(target), 2)
        normal = source_normals + target_normals
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        middle = (source_points + target_points) / 2
        J = np.hstack([np.cross(middle, normal), normal]).astype(np.float64, copy=False)
        share = np.repeat(shares, np.diff(row_ends))
        change = _LinearResiduals(overlaps, J, np.zeros(len(J)), share).evaluate(state)
        residual = np.einsum("ij,ij->i", source_points - target_points, normal) - change
        return _LinearResiduals(overlaps, J, residual, share)

    def mean_displacement(self, change: NDArray[np.float64]) -> float:
        """Return the mean displacement of the points of all views by a change of the state, metres."""
        distances = []
        for cloud, twist in zip(self.clouds, _view_twists(change), strict=True):
            offsets = cloud.points[anchor_points(cloud, DISPLACEMENT_POINTS)] - self.centre
            rotation = twist[:3]
            translation = twist[3:]
            distances.append(np.linalg.norm(np.cross(rotation, offsets) + translation, axis=1))
        return float(np.concatenate(distances).mean())

    def _move(self, view: int, indices: NDArray[np.intp], T: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the moved points of a view, from the centre, and their moved normals (M, 6)."""
        # `take` copies rows several times faster than indexing.
        points = self.clouds[view].points.take(indices, axis=0)
        normals = self.clouds[view].normals.take(indices, axis=0)
        return np.hstack([points @ T[:3, :3].T + (T[:3, 3] - self.centre), normals @ T[:3, :3].T])

    def _weight_share(self, pairs: _Overlap, n_searched: int) -> float:
        """Return the weight factor of each of the point pairs that a search of `n_searched` points found."""
        n_points = len(self.clouds[pairs.source].points)
        independent_share = min(INDEPENDENT_SHARE * n_points / n_searched, 1.0)
        return independent_share * (self.view_share[pairs.source] + self.view_share[pairs.target])


def align_views(
    views: ComparedViews, centre: NDArray[np.float64], prior: PosePrior, parameters: ChainParameters
) -> Alignment:
    """Estimate the poses that minimise the distances between all overlapping views and the cost of the prior.

    The distance of a point pair is measured along the mean of the two normals. On a cylinder, this distance does not
    depend on where the two points lie along or around the cylinder. Tukey weights reduce the effect of outliers. The
    prior determines motions that no surface constrains, for example along a straight string. If the surfaces are not
    closer than at the given poses, the given poses are kept.

    Args:
        views: The V views, with the correspondences of the first pass.
        centre: (3,) point about which the corrections rotate, metres, base frame.
        prior: Prior of the state, about the same centre.
        parameters: Method parameters; uses the radius r.

    Returns:
        The pose corrections with their covariance.

    Source:
        Replaces the pairwise ICP of section II.E.
    """
    prior_mean = np.asarray(-np.linalg.solve(prior.information, prior.gradient), dtype=np.float64)
    estimate = _Estimate(prior_mean, prior.information, is_improved=False)
    if views.correspondences:
        estimate = _fit_surfaces(_Problem(views, centre, parameters), prior, prior_mean)
    state = estimate.state
    hand_eye_information = None
    if estimate.is_improved:
        hand_eye_information = _marginal_hand_eye_information(estimate.information)
    T_base_camera = [cloud.T_base_camera for cloud in views.clouds]
    return Alignment(
        twists=_view_twists(state),
        covariance=pose_covariance(state, estimate.information, prior, T_base_camera),
        hand_eye_error=state[-N_SHARED:-N_DISPARITY],
        hand_eye_information=hand_eye_information,
        robot_errors=np.array([float(np.linalg.norm(D @ state + d)) for D, d in prior.robot_errors]),
    )


def _fit_surfaces(problem: _Problem, prior: PosePrior, initial_state: NDArray[np.float64]) -> _Estimate:
    """Return the state that aligns the surfaces, or the given poses if the surfaces are not closer there."""
    correspondences = problem.views.correspondences
    given_state = np.zeros(len(prior.gradient))
    given_residuals = problem.linearise(correspondences, given_state)
    previous = given_state
    state, _ = _solve_reweighted(given_residuals, initial_state, prior)
    # A search without any result keeps the correspondences of the last one.
    current = correspondences
    for _ in range(MAX_COARSE_PASSES):
        if problem.mean_displacement(state - previous) < CONVERGED_M:
            break
        current = problem.search(state, COARSE_SEARCH) or current
        residuals = problem.linearise(current, state)
        previous = state
        state, _ = _solve_reweighted(residuals, state, prior)
    current = problem.search(state, FINE_SEARCH) or current
    residuals = problem.linearise(current, state)
    state, information = _solve_reweighted(residuals, state, prior)

    n_searched = sum(found.n_searched for found in correspondences)
    given_margin = _surface_margin(given_residuals, given_state, correspondences, problem.parameters.r)
    margin = _surface_margin(residuals, state, current, problem.parameters.r)
    max_distance = FINE_SEARCH.max_distance_radii * problem.parameters.r
    # The mean distance of the surfaces. Its divisor is the number of points of the first search for both, so a view
    # cannot reduce the mean by moving away from the others.
    given_distance = max_distance - given_margin / n_searched
    distance = max_distance - margin / n_searched
    if distance <= given_distance:
        return _Estimate(state, information, is_improved=True)
    return _Estimate(given_state, prior.information, is_improved=False)


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
    """Return the twists (V, 6) of the views from the state (6 V + 9,)."""
    return state[:-N_SHARED].reshape(-1, 6)


def _marginal_hand_eye_information(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the information matrix (6, 6) of the hand-eye error, marginalised over the rest of the state."""
    own = np.arange(len(information) - N_SHARED, len(information) - N_DISPARITY)
    rest = np.delete(np.arange(len(information)), own)
    between = information[np.ix_(rest, own)]
    return information[np.ix_(own, own)] - between.T @ np.linalg.solve(information[np.ix_(rest, rest)], between)


def _solve_reweighted(
    residuals: _LinearResiduals, state: NDArray[np.float64], prior: PosePrior
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the state and its information matrix by iteratively reweighted least squares on fixed point pairs."""
    information = prior.information
    for _ in range(N_REWEIGHTINGS):
        distance = residuals.evaluate(state)
        sigma = max(median_sigma(distance), MIN_SIGMA_M)
        tukey = np.clip(1 - (distance / (TUKEY_CONSTANT * sigma)) ** 2, 0, 1) ** 2
        weight = tukey * (residuals.share / sigma**2)
        weighted_J = residuals.J * weight[:, None]
        row_gradients = weighted_J * distance[:, None]
        information = prior.information.copy()
        gradient = prior.gradient + prior.information @ state
        for pairs in residuals.overlaps:
            source = twist_entries(pairs.source)
            target = twist_entries(pairs.target)
            H = weighted_J[pairs.rows].T @ residuals.J[pairs.rows]
            g = row_gradients[pairs.rows].sum(axis=0)
            information[source, source] += H
            information[target, target] += H
            information[source, target] -= H
            information[target, source] -= H
            gradient[source] += g
            gradient[target] -= g
        state = np.asarray(state - np.linalg.solve(information, gradient), dtype=np.float64)
    return state, information


def _surface_margin(
    residuals: _LinearResiduals, state: NDArray[np.float64], correspondences: Sequence[Correspondences], r: float
) -> float:
    """Return by how much the pairs are closer than the maximum distance of the fine search: the sum over them, metres.

    Only pairs that the fine search accepts count. A point without such a pair has the maximum distance.
    """
    max_distance = FINE_SEARCH.max_distance_radii * r
    is_accepted = np.concatenate(
        [(found.distances < max_distance) & (found.cosines > FINE_SEARCH.min_cosine) for found in correspondences]
    )
    margins = np.maximum(max_distance - np.abs(residuals.evaluate(state)), 0)
    return float(margins[is_accepted].sum())
