"""The joint least squares of all views: surfaces brought together, poses held by what is known of them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recognition.parameters import ChainParameters
from recognition.preprocessing.normals import NormalCloud
from recognition.registration.correspondences import ANCHORS, Correspondences, anchor_points, find_correspondences
from recognition.registration.pose_prior import COMMON, PosePrior

TUKEY = 4.685
"""Residuals of more than this many sigma have no say (95 % efficiency where errors are normal)."""
SIGMA_FLOOR_M = 0.0001
"""Residuals are never taken to be smaller than this."""
INDEPENDENT_SHARE = 0.05
"""Depth errors are correlated over neighbouring pixels: of a hundred points of a view five speak for themselves.
Measured on simulated scans, so that the errors of registered poses spread as their covariance says."""
COARSE = (0.7, 0.7, 150)
"""Reach of the search for pairs as a share of r, least cosine of their normals and number of anchors, while views
still move. The pairs that were found as the views arrived are the first of all."""
MAX_COARSE = 6
FINE = (0.35, 0.8, ANCHORS)
"""The same for the last pass: a pair that is still far apart when all has settled is not the same surface."""
SETTLED_M = 0.0004
"""Points have moved less than this since the pass before, on average, and the poses have settled."""
ITERATIONS = 2
"""Reweightings in a pass."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """The most probable poses."""

    twists: NDArray[np.float64]
    """(V, 6) correction of each view about the centre: rotation vector, translation."""
    covariance: NDArray[np.float64]
    """(6 V, 6 V) of the twists."""
    calibration: NDArray[np.float64]
    """(6,) the hand-eye calibration's error that the views have in common, in the camera's frame."""
    calibration_information: NDArray[np.float64] | None
    """(6, 6) inverse covariance of it, what was known beforehand included; None where the poses are as told."""
    robot: NDArray[np.float64]
    """(V,) the robot's error in each view, in sigmas (of its six directions together)."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """Linearised distances of all pairs: `residual + J (x_first - x_second)`, one overlap after the other."""

    views: tuple[tuple[int, int, slice], ...]
    """First and second view of each overlap, by position, and its rows."""
    J: NDArray[np.float64]
    """(M, 6)"""
    residual: NDArray[np.float64]
    """(M,)"""
    share: NDArray[np.float64]
    """(M,) how much of the row's information counts."""

    def at(self, state: NDArray[np.float64]) -> NDArray[np.float64]:
        """(M,) signed distances where the views stand in `state`, metres."""
        twists = state[:-COMMON].reshape(-1, 6)
        changes = [self.J[part] @ (twists[i] - twists[j]) for i, j, part in self.views]
        return self.residual + np.concatenate(changes)


def align_views(
    clouds: Sequence[NormalCloud],
    first_pairs: Sequence[Correspondences],
    centre: NDArray[np.float64],
    prior: PosePrior,
    parameters: ChainParameters,
) -> Alignment:
    """Minimises the distances of all overlapping pairs of views at once, and the prior's cost.

    Distances are along the mean of a pair's two normals, which is exact on a cylinder however far its points have
    slid along it or round it; weights are Tukey's. Where no surface holds a view (along a straight string) the
    prior does. A result that does not bring the surfaces closer than the poses as told is not taken.
    """
    told = np.zeros(len(prior.gradient))
    state = np.asarray(-np.linalg.solve(prior.information, prior.gradient), dtype=np.float64)
    information = prior.information
    measured = False
    pairs = list(first_pairs)
    if pairs:
        first_rows = _rows(clouds, pairs, told, centre)
        before, (state, information) = told, _fit(first_rows, state, prior)
        for _ in range(MAX_COARSE):
            if _moved(clouds, state - before, centre) < SETTLED_M:
                break
            pairs = _pairs(clouds, state, centre, parameters, COARSE) or pairs
            before, (state, information) = state, _fit(_rows(clouds, pairs, state, centre), state, prior)
        pairs = _pairs(clouds, state, centre, parameters, FINE) or pairs
        rows = _rows(clouds, pairs, state, centre)
        state, information = _fit(rows, state, prior)
        looked = sum(pair.looked for pair in first_pairs)
        by_pose = _misfit(first_rows, told, first_pairs, looked, parameters)
        measured = _misfit(rows, state, pairs, looked, parameters) <= by_pose
        if not measured:
            state, information = told, prior.information
    return Alignment(
        twists=state[:-COMMON].reshape(-1, 6),
        covariance=np.asarray(np.linalg.inv(information)[:-COMMON, :-COMMON], dtype=np.float64),
        calibration=state[-COMMON:-1],
        calibration_information=_of_the_calibration(information) if measured else None,
        robot=np.array([float(np.linalg.norm(D @ state + d)) for D, d in prior.robot]),
    )


def corrections(state: NDArray[np.float64], centre: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The correction (4, 4) of each view: it turns about the centre and moves it, by the twist (6,) in `state`."""
    twists = state.reshape(-1, 6)
    T = np.tile(np.eye(4), (len(twists), 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(twists[:, :3]).as_matrix()
    T[:, :3, 3] = centre + twists[:, 3:] - T[:, :3, :3] @ centre
    return list(T)


def _of_the_calibration(information: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6, 6) information of the calibration's error, whatever the rest of the state is."""
    own = np.arange(len(information) - COMMON, len(information) - 1)
    rest = np.delete(np.arange(len(information)), own)
    between = information[np.ix_(rest, own)]
    return information[np.ix_(own, own)] - between.T @ np.linalg.solve(information[np.ix_(rest, rest)], between)


def _pairs(
    clouds: Sequence[NormalCloud],
    state: NDArray[np.float64],
    centre: NDArray[np.float64],
    parameters: ChainParameters,
    search: tuple[float, float, int],
) -> list[Correspondences]:
    T = corrections(state[:-COMMON], centre)
    return [
        overlap
        for k in range(1, len(clouds))
        for overlap in find_correspondences(clouds[k], clouds[:k], parameters, *search, T[k], T[:k])
    ]


def _rows(
    clouds: Sequence[NormalCloud],
    pairs: Sequence[Correspondences],
    state: NDArray[np.float64],
    centre: NDArray[np.float64],
) -> _Rows:
    """The pairs' distances and how they change, the views standing where `state` has them."""
    T = corrections(state[:-COMMON], centre)
    moved = [
        np.hstack([cloud.points @ A[:3, :3].T + (A[:3, 3] - centre), cloud.normals @ A[:3, :3].T])
        for cloud, A in zip(clouds, T, strict=True)
    ]
    position = {cloud.view: k for k, cloud in enumerate(clouds)}
    ends = np.cumsum([0, *(len(pair.at_first) for pair in pairs)])
    views = tuple(
        (position[pair.first], position[pair.second], slice(int(a), int(b)))
        for pair, a, b in zip(pairs, ends[:-1], ends[1:], strict=True)
    )
    a = np.vstack([moved[i][pair.at_first] for (i, _, _), pair in zip(views, pairs, strict=True)])
    b = np.vstack([moved[j][pair.at_second] for (_, j, _), pair in zip(views, pairs, strict=True)])
    normal = a[:, 3:] + b[:, 3:]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    (x, y, z), (n_x, n_y, n_z) = (a[:, :3] + b[:, :3]).T / 2, normal.T
    J = np.column_stack([y * n_z - z * n_y, z * n_x - x * n_z, x * n_y - y * n_x, normal])
    # A view's errors are in its pairs with every other one: told V - 1 times, they count 2 / V each.
    shares = [
        min(INDEPENDENT_SHARE * len(clouds[i].points) / pair.looked, 1.0) * 2 / len(clouds)
        for (i, _, _), pair in zip(views, pairs, strict=True)
    ]
    here = _Rows(views, J, np.zeros(len(J)), np.repeat(shares, np.diff(ends)))
    residual = np.einsum("ij,ij->i", a[:, :3] - b[:, :3], normal) - here.at(state)
    return _Rows(views, J, residual, here.share)


def _fit(rows: _Rows, state: NDArray[np.float64], prior: PosePrior) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """State and its information by iteratively reweighted least squares on fixed pairs."""
    information = prior.information
    for _ in range(ITERATIONS):
        residual = rows.at(state)
        sigma = max(1.4826 * float(np.median(np.abs(residual))), SIGMA_FLOOR_M)
        weight = np.clip(1 - (residual / (TUKEY * sigma)) ** 2, 0, 1) ** 2 * (rows.share / sigma**2)
        weighted = rows.J * weight[:, None]
        towards = weighted * residual[:, None]
        information, gradient = prior.information.copy(), prior.gradient + prior.information @ state
        for i, j, part in rows.views:
            first, second = slice(6 * i, 6 * i + 6), slice(6 * j, 6 * j + 6)
            H, g = weighted[part].T @ rows.J[part], towards[part].sum(axis=0)
            information[first, first] += H
            information[second, second] += H
            information[first, second] -= H
            information[second, first] -= H
            gradient[first] += g
            gradient[second] -= g
        state = np.asarray(state - np.linalg.solve(information, gradient), dtype=np.float64)
    return state, information


def _misfit(
    rows: _Rows, state: NDArray[np.float64], pairs: Sequence[Correspondences], looked: int, parameters: ChainParameters
) -> float:
    """How far the surfaces are apart, metres: the mean over all that `looked`, `FINE`'s reach where nothing was near.

    Only pairs as the last pass takes them count, and `looked` is that of the overlaps with which all began: so a view
    wins nothing by leaving the others.
    """
    reach = FINE[0] * parameters.r
    near = np.concatenate([(pair.distance < reach) & (pair.cosine > FINE[1]) for pair in pairs])
    closer = float(np.maximum(reach - np.abs(rows.at(state)), 0)[near].sum())
    return reach - closer / looked


def _moved(clouds: Sequence[NormalCloud], change: NDArray[np.float64], centre: NDArray[np.float64]) -> float:
    """Mean distance by which a change of state moves the views' points."""
    distances = []
    for k, cloud in enumerate(clouds):
        some = cloud.points[anchor_points(cloud, 50)] - centre
        distances.append(
            np.linalg.norm(np.cross(change[6 * k : 6 * k + 3], some) + change[6 * k + 3 : 6 * k + 6], axis=1)
        )
    return float(np.concatenate(distances).mean())
