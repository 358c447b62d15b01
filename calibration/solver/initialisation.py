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

from calibration.geometry.se3 import invert_poses, mean_pose, nearest_rotation, rotation_angles, solve_stack
from calibration.observations import Mounting

SUBSET_SIZE = 5
"""Number of views per hypothesis."""
SEED = 0
"""Seed of the random subsets. It is fixed, so that the same poses give the same solution."""
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
RELATIVE_DAMPING = 1e-9
"""Damping of the translation of X, relative to its normal matrix. Parallel rotation axes leave the translation along
the axes undetermined."""


def equation_poses(T_base_flange: NDArray[np.float64], mounting: Mounting) -> NDArray[np.float64]:
    """Return the poses A (N, 4, 4) of A X B = Y, as in the table of the module, from the reported flange poses."""
    if mounting == "eye-in-hand":
        return T_base_flange
    return invert_poses(T_base_flange)


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

    Returns:
        The solution with the inlier views.
    """
    if middle is None:
        middle = np.zeros(3)
    views = _Views(A, B, middle, robot_m, robot_rad)
    motions = _MotionPairs.between(A, B)

    subsets = _draw_subsets(len(A))
    X = motions.solve(_masks(subsets, len(A)))
    Y = mean_pose(A[subsets] @ X[:, None] @ B[subsets])
    distances = views.combined_distances(X, Y)
    most_promising = np.argsort(_better_half_mean(distances), kind="stable")[:N_REFINED]
    refined = [_refine(_Hypothesis(X[s], Y[s], distances[s]), views, motions) for s in most_promising]
    best = min(refined, key=lambda hypothesis: hypothesis.score)

    deviation_m, deviation_rad = views.deviations(best.X, best.Y)
    return InitialGuess(
        X=best.X,
        Y=best.Y,
        inliers=best.inliers(views.min_limit_m),
        deviation_m=deviation_m,
        deviation_rad=deviation_rad,
        typical_m=best.typical_m,
    )


@dataclass(frozen=True, eq=False)
class _Views:
    """Poses of N views, and the expected noise of the robot, from which the distances to a hypothesis follow."""

    A: NDArray[np.float64]
    """(N, 4, 4) flange poses, metres."""
    B: NDArray[np.float64]
    """(N, 4, 4) board poses in the camera frame, metres."""
    middle: NDArray[np.float64]
    """(3,) point of the board at which distances are measured, board frame, metres."""
    robot_m: float
    """Prior standard deviation of the robot position error per axis, metres."""
    robot_rad: float
    """Prior standard deviation of the robot rotation error per axis, radians."""

    @property
    def min_limit_m(self) -> float:
        """Minimum limit of the combined distance of an inlier, metres."""
        # Position and rotation contribute equally to the combined distance, and both have three axes.
        return INLIER_NOISE_FACTOR * np.sqrt(3) * self.robot_m * np.sqrt(2)

    def combined_distances(self, X: NDArray[np.float64], Y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the combined distances (..., N) from hypotheses X and Y (..., 4, 4), metres."""
        lever_m = self.robot_m / self.robot_rad
        deviation_m, deviation_rad = self.deviations(X, Y)
        return np.hypot(deviation_m, lever_m * deviation_rad)

    def deviations(
        self, X: NDArray[np.float64], Y: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return distances (..., N) at `middle`, metres, and angles (..., N), radians, from A_i X B_i to Y.

        X and Y are one hypothesis (4, 4), or a stack (..., 4, 4).
        """
        Y = Y[..., None, :, :]
        boards = self.A @ X[..., None, :, :] @ self.B
        positions = boards[..., :3, :3] @ self.middle + boards[..., :3, 3]
        expected = Y[..., :3, :3] @ self.middle + Y[..., :3, 3]
        rotations = Y[..., :3, :3].swapaxes(-1, -2) @ boards[..., :3, :3]
        return np.linalg.norm(positions - expected, axis=-1), rotation_angles(rotations)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """Candidate solution of A X B = Y, with the distance of each view."""

    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    distances: NDArray[np.float64]
    """(N,) combined distances of the views, metres."""

    @property
    def score(self) -> float:
        return float(_better_half_mean(self.distances))

    @property
    def typical_m(self) -> float:
        return float(np.median(np.sort(self.distances)[: _half(len(self.distances))]))

    def inliers(self, min_limit_m: float) -> NDArray[np.bool_]:
        limit = max(INLIER_FACTOR * self.typical_m, min_limit_m)
        # Keep at least three views, because fewer views do not determine X.
        return self.distances <= max(limit, np.sort(self.distances)[min(2, len(self.distances) - 1)])


def _refine(hypothesis: _Hypothesis, views: _Views, motions: "_MotionPairs") -> _Hypothesis:
    """Estimate a hypothesis again from its inliers, as long as its score improves."""
    for _ in range(REFINEMENT_ROUNDS):
        inliers = hypothesis.inliers(views.min_limit_m)
        X = motions.solve_one(inliers)
        Y = mean_pose(views.A[inliers] @ X @ views.B[inliers])
        refined = _Hypothesis(X, Y, views.combined_distances(X, Y))
        if refined.score >= hypothesis.score:
            return hypothesis
        hypothesis = refined
    return hypothesis


def _half(count: int) -> int:
    return count // 2 + 1


def _better_half_mean(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean (...) of the smaller half of the distances (..., N)."""
    half = _half(distances.shape[-1])
    return np.partition(distances, half - 1, axis=-1)[..., :half].mean(axis=-1)


def _draw_subsets(count: int) -> NDArray[np.int64]:
    """Return subsets (S, SUBSET_SIZE) of the view indices: all, or `MAX_HYPOTHESES` random subsets if more exist."""
    size = min(SUBSET_SIZE, count)
    if comb(count, size) <= MAX_HYPOTHESES:
        return np.array(list(combinations(range(count), size)))
    rng = np.random.default_rng(SEED)
    return np.argsort(rng.random((MAX_HYPOTHESES, count)), axis=1)[:, :size]


def _masks(subsets: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    """Return the masks (S, N) of S subsets of the indices of `count` views."""
    masks = np.zeros((len(subsets), count), dtype=bool)
    np.put_along_axis(masks, subsets, True, axis=1)
    return masks


@dataclass(frozen=True, eq=False)
class _MotionPairs:
    """Terms of the closed-form solution of A_ij X = X B_ij for each pair of views (i, j).

    A hypothesis sums the terms of the pairs within its views. A_ij = A_i^-1 A_j has the rotation R_A and the
    translation t_A. B_ij = B_i B_j^-1 has the translation t_B. Each pair gives two equations for the rotation R_X and
    the translation t_X of X:

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
            axes=_sine_axes(A_ij)[..., :, None] * _sine_axes(B_ij)[..., None, :],
            normal=M @ M.swapaxes(-1, -2),
            by_rotation=M[..., :, :, None] * B_ij[..., None, None, :3, 3],
            constant=(M @ A_ij[..., :3, 3, None])[..., 0],
        )

    def solve_one(self, views: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return X (4, 4) from the pairs of views in the mask `views` (N,)."""
        return self.solve(views[None])[0]

    def solve(self, views: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return X (S, 4, 4) of S hypotheses from the masks (S, N) of their views. Each X is rigid and finite."""
        # A pair has the weight 1 if both of its views belong to the hypothesis, otherwise 0.
        pairs = (views[:, :, None] & views[:, None, :]).reshape(len(views), -1).astype(np.float64)
        X = np.zeros((len(pairs), 4, 4))
        X[:, 3, 3] = 1.0
        X[:, :3, :3] = nearest_rotation((pairs @ self.axes.reshape(-1, 9)).reshape(-1, 3, 3))
        normal = (pairs @ self.normal.reshape(-1, 9)).reshape(-1, 3, 3)
        by_rotation = (pairs @ self.by_rotation.reshape(-1, 27)).reshape(-1, 3, 3, 3)
        rotated = np.einsum("sijk,sjk->si", by_rotation, X[:, :3, :3])
        constant = pairs @ self.constant.reshape(-1, 3)
        normal += RELATIVE_DAMPING * (1.0 + np.trace(normal, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        X[:, :3, 3] = solve_stack(normal, rotated - constant)
        return X


def _sine_axes(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation axes (..., 3) times the sine of the angle.

    Unlike a rotation vector, this product is continuous at 180 degrees.
    """
    R = T[..., :3, :3]
    axis = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return axis / 2
