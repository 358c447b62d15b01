"""Many rigid transforms at once, (..., 4, 4), and their small changes (..., 6): a rotation vector, then a translation.

A small change `v` stands for `from_rotation_vector(v[3:], v[:3])`, here `small_motion(v)`: the turn and the shift do
not mix. To first order this is the exponential map of SE(3), so that the adjoint carries it from frame to frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def invert_poses(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of each."""
    result = np.zeros_like(T)
    result[..., :3, :3] = T[..., :3, :3].swapaxes(-1, -2)
    result[..., :3, 3] = -(result[..., :3, :3] @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def pose_from_twist(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 4, 4) by (..., 6)."""
    from scipy.spatial.transform import Rotation

    T = np.zeros((*v.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(v[..., :3].reshape(-1, 3)).as_matrix().reshape(*v.shape[:-1], 3, 3)
    T[..., :3, 3] = v[..., 3:]
    T[..., 3, 3] = 1.0
    return T


def twist_from_pose(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 6) by (..., 4, 4): what `pose_from_twist` undoes."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([turns.reshape(*T.shape[:-2], 3), T[..., :3, 3]], axis=-1)


def solve_stack(M: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., K) the solution x of M x = values, for symmetric or other matrices (..., K, K) and values (..., K)."""
    result: NDArray[Any] = np.linalg.solve(M, values[..., None])
    return result[..., 0]


def invert_stack(M: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., K, K) the inverse of each matrix."""
    result: NDArray[Any] = np.linalg.inv(M)
    return result


def cross_matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3, 3): `cross_matrix(a) @ b` is a x b."""
    result = np.zeros((*v.shape[:-1], 3, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return result - result.swapaxes(-1, -2)


def adjoint(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 6, 6): `T @ small_motion(v)` is `small_motion(adjoint(T) @ v) @ T` for small v."""
    R = T[..., :3, :3]
    result = np.zeros((*T.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = R
    result[..., 3:, :3] = cross_matrix(T[..., :3, 3]) @ R
    return result


def right_jacobian(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 6, 6): `small_motion(v + d)` is `small_motion(v) @ small_motion(right_jacobian(v) @ d)` for small d.

    The series of the rotation's part ends after the second power: exact enough for turns of some degrees.
    """
    W = cross_matrix(v[..., :3])
    result = np.zeros((*v.shape[:-1], 6, 6))
    result[..., :3, :3] = np.eye(3) - W / 2 + W @ W / 6
    result[..., 3:, 3:] = pose_from_twist(v)[..., :3, :3].swapaxes(-1, -2)
    return result


def mean_pose(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 4, 4) mean of (..., N, 4, 4): of the rotations the one nearest to all, by the chordal distance."""
    result = np.zeros((*T.shape[:-3], 4, 4))
    result[..., :3, :3] = nearest_rotation(T[..., :3, :3].sum(axis=-3))
    result[..., :3, 3] = T[..., :3, 3].mean(axis=-2)
    result[..., 3, 3] = 1.0
    return result


def nearest_rotation(M: NDArray[np.float64]) -> NDArray[np.float64]:
    """(..., 3, 3) the rotation R that makes the trace of R^T M largest."""
    U, _, Vt = np.linalg.svd(M)
    handedness = np.ones(M.shape[:-1])
    handedness[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return (U * handedness[..., None, :]) @ Vt


def rotation_angles(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) radians, 0 to pi, of (..., 3, 3); exact for small angles too."""
    skew = R - R.swapaxes(-1, -2)
    sine = np.sqrt(skew[..., 2, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 0] ** 2)
    return np.arctan2(sine, np.trace(R, axis1=-2, axis2=-1) - 1.0)
