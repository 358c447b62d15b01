"""Initial guess of X and Y in A X B = Y by RANSAC over a closed form, since some of the poses may be wrong.

A_i are flange poses and B_i board poses in the camera frame. The product A_i X B_i is the same Y for all views. For a
camera on the flange, A = `T_base_flange`, X = `T_flange_camera`, B = `T_camera_board`, Y = `T_base_board`. For a camera
that stands in the cell, A = `T_flange_base`, X = `T_base_camera`, B = `T_camera_board`, Y = `T_flange_board`.
"""

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_poses, mean_pose, nearest_rotation, rotation_angles

SUBSET_SIZE = 5
"""Number of views that a hypothesis is solved from."""
MAX_HYPOTHESES = 300
"""Number of hypotheses. With a third of the views wrong, about 40 of 300 have only right views; with half, nine."""
N_REFINED = 8
"""Number of the best hypotheses that are refined."""
REFINEMENT_ROUNDS = 4
"""Maximum number of rounds in which a hypothesis is solved again from its inliers."""
INLIER_FACTOR = 3.5
"""A view is an inlier if its distance is at most this many times the median of the better half."""
INLIER_NOISE_FACTOR = 5.0
"""A view is an inlier too if its distance is within this many times the prior noise of the robot."""


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """A rough solution of A X B = Y."""

    X: NDArray[np.float64]
    """(4, 4) camera pose."""
    Y: NDArray[np.float64]
    """(4, 4) board pose."""
    inliers: NDArray[np.bool_]
    """(N,) views that agree with it."""
    off_m: NDArray[np.float64]
    """(N,) distance of the middle of the board in each view from that in Y, metres."""
    off_rad: NDArray[np.float64]
    """(N,) angle between the board in each view and in Y, radians."""
    typical_m: float
    """Median distance of the better half of the views, metres. It includes the angle, times the lever arm."""


def estimate_initial_guess(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    middle: NDArray[np.float64] | None = None,
    robot_m: float = 1e-4,
    robot_rad: float = float(np.radians(0.02)),
    seed: int = 0,
) -> InitialGuess:
    """Find the solution of A X B = Y that the better half of the poses fits best.

    It never fails: for poses that do not fit together, it returns a solution with which few agree.

    Args:
        A: (N, 4, 4) flange poses, N at least 3, metres.
        B: (N, 4, 4) board poses in the camera frame, metres.
        middle: (3,) middle of the board in the board frame, where distances are measured. None: the origin.
        robot_m: Prior noise of the robot's position, metres.
        robot_rad: Prior noise of the robot's rotation, radians. `robot_m / robot_rad` is the lever arm of an angle.
        seed: Seed of the random subsets.
    """
    lever_m = robot_m / robot_rad
    subsets = _draw_subsets(len(A), seed)
    motions = _MotionPairs.between(A, B)
    X = motions.solve(_pairs_within(subsets, len(A)))
    middle = np.zeros(3) if middle is None else middle
    min_limit_m = INLIER_NOISE_FACTOR * np.sqrt(3) * robot_m * np.sqrt(2)

    Y = mean_pose(A[subsets] @ X[:, None] @ B[subsets])
    distances = _combined_distances(A, B, X, Y, middle, lever_m)
    kept = np.argsort(_better_half_mean(distances), kind="stable")[:N_REFINED]
    X, Y, distances = X[kept], Y[kept], distances[kept]
    best = _Hypothesis(X[0], Y[0], distances[0])
    for k in range(len(kept)):
        hypothesis = _Hypothesis(X[k], Y[k], distances[k])
        for _ in range(REFINEMENT_ROUNDS):
            inliers = hypothesis.inliers(min_limit_m)
            X_k = motions.solve(_pairs_within(np.flatnonzero(inliers)[None], len(A)))[0]
            Y_k = mean_pose(A[inliers] @ X_k @ B[inliers])
            refined = _Hypothesis(X_k, Y_k, _combined_distances(A, B, X_k[None], Y_k[None], middle, lever_m)[0])
            if refined.score >= hypothesis.score:
                break
            hypothesis = refined
        if hypothesis.score < best.score:
            best = hypothesis
    off_m, off_rad = _discrepancies(A, B, best.X[None], best.Y[None], middle)
    return InitialGuess(best.X, best.Y, best.inliers(min_limit_m), off_m[0], off_rad[0], best.typical_m)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """One solution of A X B = Y, with the distance of each view from it."""

    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    distances: NDArray[np.float64]
    """(N,) combined distances, metres."""

    @property
    def score(self) -> float:
        return float(_better_half_mean(self.distances[None])[0])

    @property
    def typical_m(self) -> float:
        return float(np.median(np.sort(self.distances)[: _half(len(self.distances))]))

    def inliers(self, min_limit_m: float) -> NDArray[np.bool_]:
        limit = max(INLIER_FACTOR * self.typical_m, min_limit_m)
        # At least three views: fewer have no solution.
        return self.distances <= max(limit, np.sort(self.distances)[min(2, len(self.distances) - 1)])


def _half(count: int) -> int:
    return count // 2 + 1


def _better_half_mean(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (...) mean of the smaller half of distances (..., N)."""
    half = _half(distances.shape[-1])
    return np.partition(distances, half - 1, axis=-1)[..., :half].mean(axis=-1)


def _combined_distances(A, B, X, Y, middle, lever_m: float) -> NDArray[np.float64]:
    """Return the (S, N) discrepancies of `_discrepancies` as one distance, the angle times the lever arm, metres."""
    off_m, off_rad = _discrepancies(A, B, X, Y, middle)
    return np.hypot(off_m, lever_m * off_rad)


def _discrepancies(A, B, X, Y, middle) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (S, N) distances, metres, and angles, radians, between A_i X_s B_i and Y_s."""
    boards = A @ X[:, None] @ B
    positions = boards[..., :3, :3] @ middle + boards[..., :3, 3]
    expected = Y[:, :3, :3] @ middle + Y[:, :3, 3]
    rotations = Y[:, None, :3, :3].swapaxes(-1, -2) @ boards[..., :3, :3]
    return np.linalg.norm(positions - expected[:, None], axis=-1), rotation_angles(rotations)


def _draw_subsets(count: int, seed: int) -> NDArray[np.int64]:
    """Return the (S, SUBSET_SIZE) views of each hypothesis: all subsets, or `MAX_HYPOTHESES` random ones."""
    size = min(SUBSET_SIZE, count)
    if comb(count, size) <= MAX_HYPOTHESES:
        return np.array(list(combinations(range(count), size)))
    rng = np.random.default_rng(seed)
    return np.argsort(rng.random((MAX_HYPOTHESES, count)), axis=1)[:, :size]


def _pairs_within(subsets: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Return (S, N, N) weights: 1 if both views are in the subset."""
    chosen = np.zeros((len(subsets), count))
    np.put_along_axis(chosen, subsets, 1.0, axis=1)
    return chosen[:, :, None] * chosen[:, None, :]


@dataclass(frozen=True, eq=False)
class _MotionPairs:
    """Terms of the closed form for every pair of views, so that a hypothesis is a weighted sum over pairs.

    Each pair has A_ij X = X B_ij. X rotates the axis of B_ij, times the sine of its angle, to that of A_ij, and the
    translation is linear in that of X.
    """

    axes: NDArray[np.float64]
    """(N, N, 3, 3) outer products of the axes of A_ij and B_ij."""
    normal: NDArray[np.float64]
    """(N, N, 3, 3) (R_A - I)^T (R_A - I)."""
    by_rotation: NDArray[np.float64]
    """(N, N, 3, 3, 3) (R_A - I)^T and t_B, which give the right-hand side with the rotation of X."""
    constant: NDArray[np.float64]
    """(N, N, 3) (R_A - I)^T t_A."""

    @classmethod
    def between(cls, A: NDArray[np.float64], B: NDArray[np.float64]) -> "_MotionPairs":
        A_ij = invert_poses(A)[:, None] @ A[None]
        B_ij = B[:, None] @ invert_poses(B)[None]
        M = (A_ij[..., :3, :3] - np.eye(3)).swapaxes(-1, -2)
        return cls(
            _sine_axes(A_ij)[..., :, None] * _sine_axes(B_ij)[..., None, :],
            M @ M.swapaxes(-1, -2),
            M[..., :, :, None] * B_ij[..., None, None, :3, 3],
            (M @ A_ij[..., :3, 3, None])[..., 0],
        )

    def solve(self, pairs: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (S, 4, 4) X for weights (S, N, N) of the pairs; always a rigid, finite transform."""
        pairs = pairs.reshape(len(pairs), -1)
        X = np.zeros((len(pairs), 4, 4))
        X[:, 3, 3] = 1.0
        X[:, :3, :3] = nearest_rotation((pairs @ self.axes.reshape(-1, 9)).reshape(-1, 3, 3))
        normal = (pairs @ self.normal.reshape(-1, 9)).reshape(-1, 3, 3)
        rotated = np.einsum(
            "sijk,sjk->si", (pairs @ self.by_rotation.reshape(-1, 27)).reshape(-1, 3, 3, 3), X[:, :3, :3]
        )
        # A little damping: with parallel axes, X can slide along them without limit.
        normal += 1e-9 * (1.0 + np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        X[:, :3, 3] = np.linalg.solve(normal, (rotated - pairs @ self.constant.reshape(-1, 3))[..., None])[..., 0]
        return X


def _sine_axes(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (..., 3) rotation axes times the sine of the angle.

    Unlike the rotation vector, it has no jump at 180 degrees, where it is zero.
    """
    R = T[..., :3, :3]
    axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return axis / 2
