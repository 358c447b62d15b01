"""Detection of a change of X or Y between two consecutive views.

Poses `A` (N, 4, 4) and `B` (N, 4, 4) satisfy `A X B = Y`, as in `calibration.solver.initialisation`. The residual of a
view is the twist of `inverse(Y) A X B`: rotation (rad), then translation (m).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_poses, pose_from_twist, twist_from_pose
from calibration.solver.initialisation import InitialGuess, estimate_initial_guess

Moved = Literal["X", "Y"]

MIN_VIEWS_PER_SIDE = 3
"""Minimum number of views before and after the change. Two views may both be outliers."""
NOISE_RAD, NOISE_M = np.radians(0.05), 2.5e-4
"""Lower limits of the noise per axis, radians and metres, for a good camera and a good arm. A fit to few views
underestimates the noise."""
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

    def noise(self) -> tuple[float, float]:
        """Return the standard deviations of the noise per axis, radians and metres, from the median residuals."""
        # The median length of a normal error in three coordinates is 1.538 standard deviations.
        turned, off = (np.median(np.linalg.norm(part, axis=1)) / 1.538 for part in np.split(self.residuals, 2, axis=1))
        return max(float(turned), NOISE_RAD), max(float(off), NOISE_M)

    def squares(self, noise: tuple[float, float]) -> NDArray[np.float64]:
        """Return the chi-square (N,) of each view, capped at `MAX_CHI2`. `noise` are the sigmas per axis (rad, m)."""
        scaled = self.residuals / np.repeat(noise, 3)
        return np.minimum(np.sum(scaled**2, axis=1), MAX_CHI2)


def fit_without_change(A: NDArray[np.float64], B: NDArray[np.float64]) -> Fit:
    """Fit one X and one Y to all poses A (N, 4, 4) and B (N, 4, 4)."""
    start = _guess(A, B)
    return _adjust(A, B, start.X, start.Y, start.X, start.Y, None, len(A))


def fit_changes(A: NDArray[np.float64], B: NDArray[np.float64]) -> list[Fit]:
    """Fit a change of X and a change of Y at each candidate view, to all poses A (N, 4, 4) and B (N, 4, 4)."""
    count = len(A)
    # The first half or the last half of the views contains no change. Often three quarters contain no change.
    parts = [slice(0, count - count // 4), slice(0, -(-count // 2)), slice(count // 2, count), slice(count // 4, count)]
    starts = {(part.start, part.stop): _guess(A[part], B[part]) for part in parts}
    fits = []
    for first in np.unique(np.linspace(MIN_VIEWS_PER_SIDE, count - MIN_VIEWS_PER_SIDE, MAX_SPLITS).round().astype(int)):
        whole = [(start, stop) for start, stop in starts if not start < first < stop]
        longest = max(whole, key=lambda part: part[1] - part[0])
        X, Y = starts[longest].X, starts[longest].Y
        rest = slice(first, count) if longest[0] == 0 else slice(0, first)
        other_Y = _medoid(A[rest] @ X @ B[rest])
        other_X = _medoid(invert_poses(A[rest]) @ Y @ invert_poses(B[rest]))
        Xs, Ys = ((X, other_X), (Y, other_Y)) if longest[0] == 0 else ((other_X, X), (other_Y, Y))
        fits.append(_adjust(A, B, X, Ys[0], X, Ys[1], "Y", int(first)))
        fits.append(_adjust(A, B, Xs[0], Y, Xs[1], Y, "X", int(first)))
    return fits


def _guess(A: NDArray[np.float64], B: NDArray[np.float64]) -> InitialGuess:
    some = np.unique(np.linspace(0, len(A) - 1, STARTING_VIEWS).round().astype(int))
    return estimate_initial_guess(A[some], B[some])


def _medoid(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pose (4, 4) with the smallest sum of distances to all `poses` (N, 4, 4). 0.1 m counts as 1 rad."""
    apart = twist_from_pose(invert_poses(poses)[:, None] @ poses[None]) * np.repeat([1.0, 10.0], 3)
    return poses[np.argmin(np.linalg.norm(apart, axis=2).sum(axis=1))]


def _adjust(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    X0: NDArray[np.float64],
    Y0: NDArray[np.float64],
    X1: NDArray[np.float64],
    Y1: NDArray[np.float64],
    moved: Moved | None,
    first: int,
) -> Fit:
    """Fit X0 and Y0 to the views before `first`, and X1 and Y1 to the views from `first` on. Ignore outliers.

    Only the transform `moved` differs before and after `first`.
    """
    late = np.arange(len(A)) >= first
    J = _jacobian(B, late, moved)
    fit = None
    for _ in range(STEPS):
        E = np.where(late[:, None, None], invert_poses(Y1) @ A @ X1 @ B, invert_poses(Y0) @ A @ X0 @ B)
        fit = Fit(twist_from_pose(E), moved, first)
        noise = fit.noise()
        weight = np.where(fit.squares(noise) < MAX_CHI2, 1.0, 0.0)[:, None] / np.repeat(noise, 3)
        step = np.linalg.lstsq((weight[:, :, None] * J).reshape(-1, J.shape[2]), -(weight * fit.residuals).ravel())[0]
        if float(np.abs(step).max()) < CONVERGED:
            break
        dX0, dY0, extra = step[:6], step[6:12], step[12:]
        steps = np.array([dX0, dY0, extra if moved == "X" else dX0, extra if moved == "Y" else dY0], dtype=np.float64)
        X0, Y0, X1, Y1 = np.array([X0, Y0, X1, Y1]) @ pose_from_twist(steps)
    assert fit is not None
    shift = twist_from_pose(invert_poses(Y0) @ Y1 if moved == "Y" else invert_poses(X0) @ X1)
    return Fit(fit.residuals, moved, first, shift)


def _jacobian(B: NDArray[np.float64], late: NDArray[np.bool_], moved: Moved | None) -> NDArray[np.float64]:
    """Return the Jacobian of the residuals: (N, 6, 12) for X and Y, or (N, 6, 18) with a second value of X or Y.

    The transform `moved` has the second value in the views of the mask `late` (N,).
    """
    J_X = adjoint(invert_poses(B))
    J_Y = np.broadcast_to(-np.eye(6), J_X.shape)
    if moved is None:
        return np.concatenate([J_X, J_Y], axis=2)
    changed = J_X if moved == "X" else J_Y
    constant = J_Y if moved == "X" else J_X
    early_part, late_part = np.where(late[:, None, None], 0.0, changed), np.where(late[:, None, None], changed, 0.0)
    columns = [early_part, constant] if moved == "X" else [constant, early_part]
    return np.concatenate([*columns, late_part], axis=2)
