"""Whether something was moved between two views: before and after, the views fit one another, but not across.

Poses `A` (N, 4, 4) and `B` (N, 4, 4) with `A X B = Y` hold `X` and `Y` constant; here one of them has another value
from some view on. Residuals are of `inverse(Y) A X B`, rotation vector before translation.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import adjoint, invert_poses, pose_from_twist, twist_from_pose
from calibration.solver.initialisation import InitialGuess, estimate_initial_guess

Moved = Literal["X", "Y"]

SHORTEST = 3
"""Views on either side: two may be two bad ones."""
NOISE_RAD, NOISE_M = np.radians(0.05), 2.5e-4
"""Least noise of a view along one axis: what a good camera and arm have; of few views, a fit leaves too little."""
MOST_SPLITS = 20
"""Places for the move that are tried; of more views, not every place."""
STARTING_VIEWS = 20
"""Views of a long series that a rough solution is made from."""
STEPS = 8
SETTLED = 1e-6
"""Radians and metres: a step that ends the adjustment."""
LARGEST_SQUARE = 25.0
"""A view's squared residual, in standard deviations, from which on it does not count: chance goes so far in one of
3000 views."""


@dataclass(frozen=True, eq=False)
class Fit:
    """One explanation of all views."""

    residuals: NDArray[np.float64]
    """(N, 6) rad and m."""
    moved: Moved | None = None
    first: int = 0
    """First view after the move."""
    shift: NDArray[np.float64] | None = None
    """(6,) of the move: rotation vector and translation."""

    def noise(self) -> tuple[float, float]:
        """Standard deviations of one axis, rad and m, by the better half of the views."""
        # The median length of three normal numbers is 1.538 standard deviations.
        turned, off = (np.median(np.linalg.norm(part, axis=1)) / 1.538 for part in np.split(self.residuals, 2, axis=1))
        return max(float(turned), NOISE_RAD), max(float(off), NOISE_M)

    def squares(self, noise: tuple[float, float]) -> NDArray[np.float64]:
        """(N,) squared residuals in standard deviations, up to `LARGEST_SQUARE`."""
        scaled = self.residuals / np.repeat(noise, 3)
        return np.minimum(np.sum(scaled**2, axis=1), LARGEST_SQUARE)


def fit_without_change(A: NDArray[np.float64], B: NDArray[np.float64]) -> Fit:
    """All views with one X and one Y."""
    start = _rough(A, B)
    return _adjusted(A, B, start.X, start.Y, start.X, start.Y, None, len(A))


def fit_changes(A: NDArray[np.float64], B: NDArray[np.float64]) -> list[Fit]:
    """All views with X, or with Y, of another value from each possible view on."""
    count = len(A)
    # What is not interrupted by the move is the first half or the last, and often three quarters.
    parts = [slice(0, count - count // 4), slice(0, -(-count // 2)), slice(count // 2, count), slice(count // 4, count)]
    starts = {(part.start, part.stop): _rough(A[part], B[part]) for part in parts}
    fits = []
    for first in np.unique(np.linspace(SHORTEST, count - SHORTEST, MOST_SPLITS).round().astype(int)):
        whole = [(start, stop) for start, stop in starts if not start < first < stop]
        longest = max(whole, key=lambda part: part[1] - part[0])
        X, Y = starts[longest].X, starts[longest].Y
        rest = slice(first, count) if longest[0] == 0 else slice(0, first)
        other_Y = _middle(A[rest] @ X @ B[rest])
        other_X = _middle(invert_poses(A[rest]) @ Y @ invert_poses(B[rest]))
        Xs, Ys = ((X, other_X), (Y, other_Y)) if longest[0] == 0 else ((other_X, X), (other_Y, Y))
        fits.append(_adjusted(A, B, X, Ys[0], X, Ys[1], "Y", int(first)))
        fits.append(_adjusted(A, B, Xs[0], Y, Xs[1], Y, "X", int(first)))
    return fits


def _rough(A: NDArray[np.float64], B: NDArray[np.float64]) -> InitialGuess:
    some = np.unique(np.linspace(0, len(A) - 1, STARTING_VIEWS).round().astype(int))
    return estimate_initial_guess(A[some], B[some])


def _middle(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """The one of the poses (N, 4, 4) that is nearest to the others, 0.1 m counting as a radian."""
    apart = twist_from_pose(invert_poses(poses)[:, None] @ poses[None]) * np.repeat([1.0, 10.0], 3)
    return poses[np.argmin(np.linalg.norm(apart, axis=2).sum(axis=1))]


def _adjusted(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    X0: NDArray[np.float64],
    Y0: NDArray[np.float64],
    X1: NDArray[np.float64],
    Y1: NDArray[np.float64],
    moved: Moved | None,
    first: int,
) -> Fit:
    """Least squares over what is free, of the views that fit: X0 and Y0 before view `first`, X1 and Y1 from it on."""
    late = np.arange(len(A)) >= first
    J = _jacobian(B, late, moved)
    fit = None
    for _ in range(STEPS):
        E = np.where(late[:, None, None], invert_poses(Y1) @ A @ X1 @ B, invert_poses(Y0) @ A @ X0 @ B)
        fit = Fit(twist_from_pose(E), moved, first)
        noise = fit.noise()
        weight = np.where(fit.squares(noise) < LARGEST_SQUARE, 1.0, 0.0)[:, None] / np.repeat(noise, 3)
        step = np.linalg.lstsq((weight[:, :, None] * J).reshape(-1, J.shape[2]), -(weight * fit.residuals).ravel())[0]
        if float(np.abs(step).max()) < SETTLED:
            break
        dX0, dY0, extra = step[:6], step[6:12], step[12:]
        steps = np.array([dX0, dY0, extra if moved == "X" else dX0, extra if moved == "Y" else dY0], dtype=np.float64)
        X0, Y0, X1, Y1 = np.array([X0, Y0, X1, Y1]) @ pose_from_twist(steps)
    assert fit is not None
    shift = twist_from_pose(invert_poses(Y0) @ Y1 if moved == "Y" else invert_poses(X0) @ X1)
    return Fit(fit.residuals, moved, first, shift)


def _jacobian(B: NDArray[np.float64], late: NDArray[np.bool_], moved: Moved | None) -> NDArray[np.float64]:
    """(N, 6, 12 or 18) of the residuals by small motions of X and Y on their right, and of the moved one after."""
    by_X = adjoint(invert_poses(B))
    by_Y = np.broadcast_to(-np.eye(6), by_X.shape)
    if moved is None:
        return np.concatenate([by_X, by_Y], axis=2)
    changed = by_X if moved == "X" else by_Y
    constant = by_Y if moved == "X" else by_X
    early_part, late_part = np.where(late[:, None, None], 0.0, changed), np.where(late[:, None, None], changed, 0.0)
    columns = [early_part, constant] if moved == "X" else [constant, early_part]
    return np.concatenate([*columns, late_part], axis=2)
