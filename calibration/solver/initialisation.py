"""Initial guess of X and Y in A X B = Y by RANSAC with a closed-form solution, robust to wrong poses.

View i has the flange pose A_i and the board pose B_i in the camera frame. The product A_i X B_i equals Y in all views.

    eye-in-hand    A = T_base_flange    X = T_flange_camera    B = T_camera_board    Y = T_base_board
    eye-to-hand    A = T_flange_base    X = T_base_camera      B = T_camera_board    Y = T_flange_board
"""

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.se3 import invert_poses, mean_pose, nearest_rotation, rotation_angles

SUBSET_SIZE = 5
"""Number of views per hypothesis."""
MAX_HYPOTHESES = 300
"""Maximum number of hypotheses. With a third of the views wrong, about 40 of 300 random subsets contain no wrong view;
with half of the views wrong, about nine."""
N_REFINED = 8
"""Number of hypotheses that are refined: those with the best scores."""
REFINEMENT_ROUNDS = 4
"""Maximum number of times that a hypothesis is estimated again from its inliers."""
INLIER_FACTOR = 3.5
"""A view is an inlier if its distance is at most this multiple of the median distance of the better half of the
views."""
INLIER_NOISE_FACTOR = 5.0
"""A view is also an inlier if its distance is at most this multiple of the root mean square distance that the prior
robot noise causes."""


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """Rough solution of A X B = Y."""

    X: NDArray[np.float64]
    """(4, 4) camera pose X, metres."""
    Y: NDArray[np.float64]
    """(4, 4) board pose Y, metres."""
    inliers: NDArray[np.bool_]
    """(N,) mask, True for views that agree with the solution."""
    deviation_m: NDArray[np.float64]
    """(N,) distance between the middle of the board at A_i X B_i and at Y, metres."""
    deviation_rad: NDArray[np.float64]
    """(N,) rotation angle between A_i X B_i and Y, radians."""
    typical_m: float
    """Median combined distance of the better half of the views, metres. The combined distance is
    `hypot(deviation_m, lever_m * deviation_rad)` with the lever arm `lever_m = robot_m / robot_rad`."""


def estimate_initial_guess(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    middle: NDArray[np.float64] | None = None,
    robot_m: float = 1e-4,
    robot_rad: float = float(np.radians(0.02)),
    seed: int = 0,
) -> InitialGuess:
    """Estimate X and Y in A X B = Y robustly, from random subsets of the views.

    The result is the solution with the smallest mean distance over the better half of the views. The function always
    returns a solution. If the poses are inconsistent, few views are inliers.

    Args:
        A: (N, 4, 4) flange poses, N >= 3, metres. The module docstring gives the frames.
        B: (N, 4, 4) board poses in the camera frame, metres.
        middle: (3,) middle of the board, board frame, metres. Distances between board poses are measured at this point.
            None: the origin.
        robot_m: Prior standard deviation of the robot position error per axis, metres.
        robot_rad: Prior standard deviation of the robot rotation error per axis, radians. The lever arm
            `robot_m / robot_rad` converts angles to distances.
        seed: Seed of the random subsets.

    Returns:
        The solution with the inlier views.
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
    deviation_m, deviation_rad = _discrepancies(A, B, best.X[None], best.Y[None], middle)
    return InitialGuess(best.X, best.Y, best.inliers(min_limit_m), deviation_m[0], deviation_rad[0], best.typical_m)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """Candidate solution of A X B = Y, with the distance of each view."""

    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    distances: NDArray[np.float64]
    """(N,) combined distances from `_combined_distances`, metres."""

    @property
    def score(self) -> float:
        return float(_better_half_mean(self.distances[None])[0])

    @property
    def typical_m(self) -> float:
        return float(np.median(np.sort(self.distances)[: _half(len(self.distances))]))

    def inliers(self, min_limit_m: float) -> NDArray[np.bool_]:
        limit = max(INLIER_FACTOR * self.typical_m, min_limit_m)
        # Keep at least three views, because fewer views do not determine X.
        return self.distances <= max(limit, np.sort(self.distances)[min(2, len(self.distances) - 1)])


def _half(count: int) -> int:
    return count // 2 + 1


def _better_half_mean(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean (...) of the smaller half of the distances (..., N)."""
    half = _half(distances.shape[-1])
    return np.partition(distances, half - 1, axis=-1)[..., :half].mean(axis=-1)


def _combined_distances(A, B, X, Y, middle, lever_m: float) -> NDArray[np.float64]:
    """Return the combined distances (S, N) of N views from S hypotheses, metres. Angles are multiplied by `lever_m`."""
    deviation_m, deviation_rad = _discrepancies(A, B, X, Y, middle)
    return np.hypot(deviation_m, lever_m * deviation_rad)


def _discrepancies(A, B, X, Y, middle) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return distances (S, N) at the point `middle`, metres, and angles (S, N), radians, from A_i X_s B_i to Y_s."""
    boards = A @ X[:, None] @ B
    positions = boards[..., :3, :3] @ middle + boards[..., :3, 3]
    expected = Y[:, :3, :3] @ middle + Y[:, :3, 3]
    rotations = Y[:, None, :3, :3].swapaxes(-1, -2) @ boards[..., :3, :3]
    return np.linalg.norm(positions - expected[:, None], axis=-1), rotation_angles(rotations)


def _draw_subsets(count: int, seed: int) -> NDArray[np.int64]:
    """Return subsets (S, SUBSET_SIZE) of the view indices: all, or `MAX_HYPOTHESES` random subsets if more exist."""
    size = min(SUBSET_SIZE, count)
    if comb(count, size) <= MAX_HYPOTHESES:
        return np.array(list(combinations(range(count), size)))
    rng = np.random.default_rng(seed)
    return np.argsort(rng.random((MAX_HYPOTHESES, count)), axis=1)[:, :size]


def _pairs_within(subsets: NDArray[np.int64], count: int) -> NDArray[np.float64]:
    """Return weights (S, N, N) of the view pairs for S subsets: 1 if the subset contains the pair, otherwise 0."""
    chosen = np.zeros((len(subsets), count))
    np.put_along_axis(chosen, subsets, 1.0, axis=1)
    return chosen[:, :, None] * chosen[:, None, :]


@dataclass(frozen=True, eq=False)
class _MotionPairs:
    """Terms of the closed-form solution of A_ij X = X B_ij for each pair of views (i, j).

    A hypothesis sums the terms of its pairs. A_ij = A_i^-1 A_j has the rotation R_A and the translation t_A. B_ij =
    B_i B_j^-1 has the translation t_B. Each pair gives two equations for the rotation R_X and the translation t_X of X:

        a_ij = R_X b_ij                     a_ij, b_ij: rotation axes of A_ij, B_ij times the sine of the angle
        (R_A - I) t_X = R_X t_B - t_A
    """

    axes: NDArray[np.float64]
    """(N, N, 3, 3) outer products a_ij b_ij^T."""
    normal: NDArray[np.float64]
    """(N, N, 3, 3) normal matrices (R_A - I)^T (R_A - I) of t_X."""
    by_rotation: NDArray[np.float64]
    """(N, N, 3, 3, 3) outer products of (R_A - I)^T and t_B. The contraction of the last two axes with R_X gives
    (R_A - I)^T R_X t_B."""
    constant: NDArray[np.float64]
    """(N, N, 3) vectors (R_A - I)^T t_A, subtracted from the right-hand side of t_X."""

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
        """Return X (S, 4, 4) of S hypotheses from the pair weights (S, N, N). Each X is rigid and finite."""
        pairs = pairs.reshape(len(pairs), -1)
        X = np.zeros((len(pairs), 4, 4))
        X[:, 3, 3] = 1.0
        X[:, :3, :3] = nearest_rotation((pairs @ self.axes.reshape(-1, 9)).reshape(-1, 3, 3))
        normal = (pairs @ self.normal.reshape(-1, 9)).reshape(-1, 3, 3)
        rotated = np.einsum(
            "sijk,sjk->si", (pairs @ self.by_rotation.reshape(-1, 27)).reshape(-1, 3, 3, 3), X[:, :3, :3]
        )
        # Damping, because parallel rotation axes leave the translation along the axes undetermined.
        normal += 1e-9 * (1.0 + np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        X[:, :3, 3] = np.linalg.solve(normal, (rotated - pairs @ self.constant.reshape(-1, 3))[..., None])[..., 0]
        return X


def _sine_axes(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation axes (..., 3) times the sine of the angle.

    Unlike a rotation vector, this product is continuous at 180 degrees.
    """
    R = T[..., :3, :3]
    axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return axis / 2
