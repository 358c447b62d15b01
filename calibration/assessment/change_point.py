"""Detection of a change of X or Y between two consecutive views.

Poses `A` (N, 4, 4) and `B` (N, 4, 4) satisfy `A X B = Y`, as in `calibration.solver.initialisation`. The residual of a
view is the twist of `inverse(Y) A X B`: rotation (rad), then translation (m).
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_poses, pose_from_twist, twist_from_pose
from calibration.solver.initialisation import InitialGuess, estimate_initial_guess

Moved = Literal["X", "Y"]

MIN_VIEWS_PER_SIDE = 3
"""Minimum number of views before and after the change. Two views may both be outliers."""
MIN_NOISE_RAD = np.radians(0.05)
"""Lower limit of the rotation noise per axis, radians, for a good camera and a good arm. A fit to few views
underestimates the noise."""
MIN_NOISE_M = 2.5e-4
"""Lower limit of the position noise per axis, metres, for the same reason."""
MEDIAN_LENGTH_SIGMAS = 1.538
"""Median length of a normal error in three coordinates, in standard deviations per coordinate."""
MAX_SPLITS = 20
"""Maximum number of views that are tried as the first view after the change."""
STARTING_VIEWS = 20
"""Maximum number of views for an initial guess."""
STEPS = 8
"""Maximum number of Gauss-Newton steps."""
CONVERGED = 1e-6
"""Step size, radians and metres, below which the fit has converged."""
MAX_CHI2 = 25.0
"""Chi-square from which a view is an outlier. Noise exceeds this limit in one of 3000 views."""


@dataclass(frozen=True)
class PoseNoise:
    """Standard deviations of the residuals per axis."""

    rad: float
    """Rotation noise, radians."""
    m: float
    """Position noise, metres."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Fit of X and Y to N views, without a change or with a change of X or Y."""

    residuals: NDArray[np.float64]
    """(N, 6) residuals of the views, rotation (rad), then translation (m)."""
    moved: Moved | None = None
    """Transform that changes, `X` or `Y`; None for a fit without a change."""
    first: int = 0
    """Index of the first view after the change."""
    shift: NDArray[np.float64] | None = None
    """(6,) change of X or Y, rotation (rad), then translation (m); zero without a change, None before convergence."""

    def noise(self) -> PoseNoise:
        """Return the noise, estimated from the median residuals."""
        return PoseNoise(
            rad=max(_median_sigma(self.residuals[:, :3]), MIN_NOISE_RAD),
            m=max(_median_sigma(self.residuals[:, 3:]), MIN_NOISE_M),
        )

    def squares(self, noise: PoseNoise) -> NDArray[np.float64]:
        """Return the chi-square (N,) of each view, capped at `MAX_CHI2`."""
        scaled = self.residuals / np.repeat([noise.rad, noise.m], 3)
        return np.minimum(np.sum(scaled**2, axis=1), MAX_CHI2)


def fit_without_change(A: NDArray[np.float64], B: NDArray[np.float64]) -> Fit:
    """Fit one X and one Y to all poses A (N, 4, 4) and B (N, 4, 4)."""
    guess = _guess(A, B)
    return _adjust(A, B, _Change(_twice(guess.X), _twice(guess.Y), moved=None, first=len(A)))


def fit_changes(A: NDArray[np.float64], B: NDArray[np.float64]) -> list[Fit]:
    """Fit a change of X and a change of Y at each candidate view, to all poses A (N, 4, 4) and B (N, 4, 4)."""
    count = len(A)
    # The first half or the last half of the views contains no change. Often three quarters contain no change.
    parts = [
        _guess_part(A, B, 0, count - count // 4),
        _guess_part(A, B, 0, count - count // 2),
        _guess_part(A, B, count // 2, count),
        _guess_part(A, B, count // 4, count),
    ]
    fits = []
    for first in np.unique(np.linspace(MIN_VIEWS_PER_SIDE, count - MIN_VIEWS_PER_SIDE, MAX_SPLITS).round().astype(int)):
        unchanged = [part for part in parts if not part.start < first < part.stop]
        longest = max(unchanged, key=lambda part: part.stop - part.start)
        fits.append(_adjust(A, B, _start_with_moved_Y(A, B, longest, int(first))))
        fits.append(_adjust(A, B, _start_with_moved_X(A, B, longest, int(first))))
    return fits


@dataclass(frozen=True, eq=False)
class _Part:
    """Consecutive views, with X and Y estimated from these views alone."""

    start: int
    """Index of the first view."""
    stop: int
    """Index after the last view."""
    X: NDArray[np.float64]
    """(4, 4) estimate of X."""
    Y: NDArray[np.float64]
    """(4, 4) estimate of Y."""

    def in_view_order(self, own: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the transform of this part and that of the other views (2, 4, 4), in the order of the views."""
        if self.start == 0:
            return np.array([own, other])
        return np.array([other, own])

    def others(self, first: int) -> slice:
        """Return the views on the other side of a change at the view `first`."""
        if self.start == 0:
            return slice(first, None)
        return slice(0, first)


def _guess_part(A: NDArray[np.float64], B: NDArray[np.float64], start: int, stop: int) -> _Part:
    guess = _guess(A[start:stop], B[start:stop])
    return _Part(start, stop, guess.X, guess.Y)


@dataclass(frozen=True, eq=False)
class _Change:
    """X and Y before and after a change."""

    X: NDArray[np.float64]
    """(2, 4, 4) X before and after the change."""
    Y: NDArray[np.float64]
    """(2, 4, 4) Y before and after the change."""
    moved: Moved | None
    """Transform that changes. The other one is equal before and after."""
    first: int
    """Index of the first view after the change."""

    def shift(self) -> NDArray[np.float64]:
        """Return the twist (6,) of the change."""
        before, after = self.Y if self.moved == "Y" else self.X
        return twist_from_pose(invert_poses(before) @ after)


def _start_with_moved_Y(A: NDArray[np.float64], B: NDArray[np.float64], part: _Part, first: int) -> _Change:
    rest = part.others(first)
    other_Y = _medoid(A[rest] @ part.X @ B[rest])
    return _Change(_twice(part.X), part.in_view_order(part.Y, other_Y), "Y", first)


def _start_with_moved_X(A: NDArray[np.float64], B: NDArray[np.float64], part: _Part, first: int) -> _Change:
    rest = part.others(first)
    other_X = _medoid(invert_poses(A[rest]) @ part.Y @ invert_poses(B[rest]))
    return _Change(part.in_view_order(part.X, other_X), _twice(part.Y), "X", first)


def _twice(T: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([T, T])


def _median_sigma(errors: NDArray[np.float64]) -> float:
    """Return the standard deviation per coordinate of errors (N, 3), from their median length."""
    return float(np.median(np.linalg.norm(errors, axis=1)) / MEDIAN_LENGTH_SIGMAS)


def _guess(A: NDArray[np.float64], B: NDArray[np.float64]) -> InitialGuess:
    some = np.unique(np.linspace(0, len(A) - 1, STARTING_VIEWS).round().astype(int))
    return estimate_initial_guess(A[some], B[some])


def _medoid(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pose (4, 4) with the smallest sum of distances to all `poses` (N, 4, 4). 0.1 m counts as 1 rad."""
    apart = twist_from_pose(invert_poses(poses)[:, None] @ poses[None]) * np.repeat([1.0, 10.0], 3)
    return poses[np.argmin(np.linalg.norm(apart, axis=2).sum(axis=1))]


def _adjust(A: NDArray[np.float64], B: NDArray[np.float64], change: _Change) -> Fit:
    """Fit X and Y before and after a change to all views, from the initial values `change`. Ignore outliers."""
    moved = change.moved
    is_after = np.arange(len(A)) >= change.first
    side = is_after.astype(np.int64)  # 0 before the change, 1 after
    J = _jacobian(B, is_after, moved)
    fit = None
    for _ in range(STEPS):
        E = invert_poses(change.Y)[side] @ A @ change.X[side] @ B
        fit = Fit(twist_from_pose(E), moved, change.first)
        noise = fit.noise()
        inlier_weight = np.where(fit.squares(noise) < MAX_CHI2, 1.0, 0.0)
        weight = inlier_weight[:, None] / np.repeat([noise.rad, noise.m], 3)
        step = np.linalg.lstsq((weight[:, :, None] * J).reshape(-1, J.shape[2]), -(weight * fit.residuals).ravel())[0]
        if float(np.abs(step).max()) < CONVERGED:
            break
        dX = np.array([step[:6], step[:6]], dtype=np.float64)
        dY = np.array([step[6:12], step[6:12]], dtype=np.float64)
        if moved == "X":
            dX[1] = step[12:]
        elif moved == "Y":
            dY[1] = step[12:]
        change = replace(change, X=change.X @ pose_from_twist(dX), Y=change.Y @ pose_from_twist(dY))
    assert fit is not None
    return replace(fit, shift=change.shift())


def _jacobian(B: NDArray[np.float64], is_after: NDArray[np.bool_], moved: Moved | None) -> NDArray[np.float64]:
    """Return the Jacobian of the residuals: (N, 6, 12) for X and Y, or (N, 6, 18) with a second value of X or Y.

    The transform `moved` has the second value in the views of the mask `is_after` (N,).
    """
    J_X = adjoint(invert_poses(B))
    J_Y = np.broadcast_to(-np.eye(6), J_X.shape)
    is_after = is_after[:, None, None]
    if moved == "X":
        return np.concatenate([np.where(is_after, 0.0, J_X), J_Y, np.where(is_after, J_X, 0.0)], axis=2)
    if moved == "Y":
        return np.concatenate([J_X, np.where(is_after, 0.0, J_Y), np.where(is_after, J_Y, 0.0)], axis=2)
    return np.concatenate([J_X, J_Y], axis=2)
