"""A first solution of A X B = Y from poses of which some are wrong: RANSAC over a closed form.

A_i are flange poses, B_i board poses in the camera; the product A_i X B_i ought to be one Y for all i. With a camera on
the flange, A = `T_base_flange`, X = `T_flange_camera`, B = `T_camera_board`, Y = `T_base_board`; with a camera that
stands in the cell, A = `T_flange_base`, X = `T_base_camera`, Y = `T_flange_board`.
"""

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_poses, mean_pose, nearest_rotation, rotation_angles

SUBSET = 5
"""Views that a guess is made from."""
GUESSES = 300
"""With a third of the views wrong, 300 guesses hold about 40 of right ones only; with half, nine."""
KEPT = 8
"""So many of the best guesses are worked out further."""
ROUNDS = 4
AGREES = 3.5
"""A view agrees that is not farther off than this many times the median of the better half."""
NEVER_TOO_FAR = 5.0
"""Nor is a view left out here that is within so many times the robot's assumed noise."""


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """A rough solution."""

    X: NDArray[np.float64]
    """(4, 4)."""
    Y: NDArray[np.float64]
    """(4, 4)."""
    inliers: NDArray[np.bool_]
    """(N,) which views agree with it."""
    off_m: NDArray[np.float64]
    """(N,) how far the board is from Y by each view, at its middle."""
    off_rad: NDArray[np.float64]
    """(N,) how far it is turned."""
    typical_m: float
    """Median of the better half's distances, the turn counted as a distance too."""


def estimate_initial_guess(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    middle: NDArray[np.float64] | None = None,
    robot_m: float = 1e-4,
    robot_rad: float = float(np.radians(0.02)),
    seed: int = 0,
) -> InitialGuess:
    """The solution that more than half of the poses A, B (N, 4, 4), N at least 3, agree with best.

    `middle` (3,) is the board's middle in its own frame, where distances are taken. `robot_m` and `robot_rad` say how
    many metres a radian counts as, and what is too little to be wrong. Never fails: of poses that do not go together,
    something comes out that few agree with.
    """
    lever = robot_m / robot_rad
    subsets = _subsets(len(A), seed)
    motions = _Motions.between(A, B)
    X = motions.solved(_pairs_within(subsets, len(A)))
    middle = np.zeros(3) if middle is None else middle
    floor = NEVER_TOO_FAR * np.sqrt(3) * robot_m * np.sqrt(2)

    Y = mean_pose(A[subsets] @ X[:, None] @ B[subsets])
    off = _off(A, B, X, Y, middle)
    together = np.hypot(off[0], lever * off[1])
    kept = np.argsort(_score(together), kind="stable")[:KEPT]
    X, Y, together = X[kept], Y[kept], together[kept]
    best = _Guess(X[0], Y[0], together[0])
    for k in range(len(kept)):
        guess = _Guess(X[k], Y[k], together[k])
        for _ in range(ROUNDS):
            inliers = guess.inliers(floor)
            X_k = motions.solved(_pairs_among(inliers)[None])[0]
            Y_k = mean_pose(A[inliers] @ X_k @ B[inliers])
            off = _off(A, B, X_k[None], Y_k[None], middle)
            better = _Guess(X_k, Y_k, np.hypot(off[0], lever * off[1])[0])
            if better.score >= guess.score:
                break
            guess = better
        if guess.score < best.score:
            best = guess
    off = _off(A, B, best.X[None], best.Y[None], middle)
    return InitialGuess(best.X, best.Y, best.inliers(floor), off[0][0], off[1][0], best.typical)


@dataclass(frozen=True, eq=False)
class _Guess:
    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    off: NDArray[np.float64]
    """(N,) metres, the turn counted as metres too."""

    @property
    def score(self) -> float:
        return float(_score(self.off[None])[0])

    @property
    def typical(self) -> float:
        return float(np.median(np.sort(self.off)[: _half(len(self.off))]))

    def inliers(self, floor: float) -> NDArray[np.bool_]:
        limit = max(AGREES * self.typical, floor)
        # Three views at least: fewer have no solution.
        return self.off <= max(limit, np.sort(self.off)[min(2, len(self.off) - 1)])


def _half(count: int) -> int:
    return count // 2 + 1


def _score(off: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) how well each guess fits its better half, (..., N)."""
    half = _half(off.shape[-1])
    return np.partition(off, half - 1, axis=-1)[..., :half].mean(axis=-1)


def _off(A, B, X, Y, middle) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(S, N) metres and radians between A_i X_s B_i and Y_s."""
    boards = A @ X[:, None] @ B
    places = boards[..., :3, :3] @ middle + boards[..., :3, 3]
    expected = Y[:, :3, :3] @ middle + Y[:, :3, 3]
    turns = Y[:, None, :3, :3].swapaxes(-1, -2) @ boards[..., :3, :3]
    return np.linalg.norm(places - expected[:, None], axis=-1), rotation_angles(turns)


def _subsets(count: int, seed: int) -> NDArray[np.int64]:
    """(S, SUBSET) views of each guess: all there are, or `GUESSES` of them at random."""
    size = min(SUBSET, count)
    if comb(count, size) <= GUESSES:
        return np.array(list(combinations(range(count), size)))
    rng = np.random.default_rng(seed)
    return np.argsort(rng.random((GUESSES, count)), axis=1)[:, :size]


def _pairs_within(subsets: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """(S, N, N) 1 where both views are in the subset."""
    chosen = np.zeros((len(subsets), count))
    np.put_along_axis(chosen, subsets, 1.0, axis=1)
    return chosen[:, :, None] * chosen[:, None, :]


def _pairs_among(inliers: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.outer(inliers, inliers).astype(np.float64)


@dataclass(frozen=True, eq=False)
class _Motions:
    """Of every pair of views, what it says of X, so that a guess is a weighted sum: A_ij X = X B_ij, in which the
    rotation's axis, times the sine of its angle, is turned by X, and the translation is linear in X's."""

    axes: NDArray[np.float64]
    """(N, N, 3, 3) outer products of the axes of A_ij and B_ij."""
    normal: NDArray[np.float64]
    """(N, N, 3, 3) (R_A - I)^T (R_A - I)."""
    by_rotation: NDArray[np.float64]
    """(N, N, 3, 3, 3) (R_A - I)^T and t_B, of which the right-hand side is made with the rotation of X."""
    constant: NDArray[np.float64]
    """(N, N, 3) (R_A - I)^T t_A."""

    @classmethod
    def between(cls, A: NDArray[np.float64], B: NDArray[np.float64]) -> "_Motions":
        A_ij = invert_poses(A)[:, None] @ A[None]
        B_ij = B[:, None] @ invert_poses(B)[None]
        M = (A_ij[..., :3, :3] - np.eye(3)).swapaxes(-1, -2)
        return cls(
            _sine_axes(A_ij)[..., :, None] * _sine_axes(B_ij)[..., None, :],
            M @ M.swapaxes(-1, -2),
            M[..., :, :, None] * B_ij[..., None, None, :3, 3],
            (M @ A_ij[..., :3, 3, None])[..., 0],
        )

    def solved(self, pairs: NDArray[np.float64]) -> NDArray[np.float64]:
        """(S, 4, 4) X by the `pairs` (S, N, N) of weight 1; always a proper, finite transform."""
        pairs = pairs.reshape(len(pairs), -1)
        X = np.zeros((len(pairs), 4, 4))
        X[:, 3, 3] = 1.0
        X[:, :3, :3] = nearest_rotation((pairs @ self.axes.reshape(-1, 9)).reshape(-1, 3, 3))
        normal = (pairs @ self.normal.reshape(-1, 9)).reshape(-1, 3, 3)
        turned = np.einsum(
            "sijk,sjk->si", (pairs @ self.by_rotation.reshape(-1, 27)).reshape(-1, 3, 3, 3), X[:, :3, :3]
        )
        # A touch of damping: with parallel axes X may slide along them without end.
        normal += 1e-9 * (1.0 + np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        X[:, :3, 3] = np.linalg.solve(normal, (turned - pairs @ self.constant.reshape(-1, 3))[..., None])[..., 0]
        return X


def _sine_axes(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3) the rotation's axis times the sine of its angle: unlike the rotation vector without a jump at 180
    degrees, where it says nothing."""
    R = T[..., :3, :3]
    axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return axis / 2
