"""Stacks of rigid transforms (..., 4, 4) and twists (..., 6).

A twist `v` is a small change of a transform: rotation vector (rad), then translation (m). Its transform is
`pose_from_twist(v)`, with the rotation vector `v[:3]` and the translation `v[3:]`. This map differs from the
exponential map of SE(3), whose translation also depends on the rotation. The two maps are equal to first order, so the
adjoint transforms twists between frames.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def invert_poses(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverses (..., 4, 4) of rigid transforms (..., 4, 4)."""
    result = np.zeros_like(T)
    result[..., :3, :3] = T[..., :3, :3].swapaxes(-1, -2)
    result[..., :3, 3] = -(result[..., :3, :3] @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def pose_from_twist(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transforms (..., 4, 4) of twists (..., 6): rotation vector (rad), then translation (m).

    This is not the exponential map of SE(3): the translation of the transform is `v[..., 3:]`.
    """
    from scipy.spatial.transform import Rotation

    # SciPy's RigidTransform would orthonormalise the rotation again, which changes the last digit.
    T = np.zeros((*v.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_rotvec(v[..., :3]).as_matrix()
    T[..., :3, 3] = v[..., 3:]
    T[..., 3, 3] = 1.0
    return T


def twist_from_pose(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the twists (..., 6) of transforms (..., 4, 4), as the inverse of `pose_from_twist`."""
    from scipy.spatial.transform import Rotation

    # Flatten the stack, because SciPy's formula for stacks with more axes differs in the last digit.
    rotation_vectors = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([rotation_vectors.reshape(*T.shape[:-2], 3), T[..., :3, 3]], axis=-1)


def solve_stack(M: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the solutions x (..., K) of `M @ x = values` for matrices M (..., K, K) and values (..., K)."""
    result: NDArray[Any] = np.linalg.solve(M, values[..., None])
    return result[..., 0]


def invert_stack(M: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverses (..., K, K) of matrices (..., K, K)."""
    result: NDArray[Any] = np.linalg.inv(M)
    return result


def cross_matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the skew-symmetric matrices (..., 3, 3) of vectors (..., 3): `cross_matrix(a) @ b = a x b`."""
    result = np.zeros((*v.shape[:-1], 3, 3))
    result[..., 0, 1] = -v[..., 2]
    result[..., 0, 2] = v[..., 1]
    result[..., 1, 2] = -v[..., 0]
    return result - result.swapaxes(-1, -2)


def adjoint(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the adjoints (..., 6, 6) of transforms (..., 4, 4).

    For a small twist v: `T @ pose_from_twist(v) = pose_from_twist(adjoint(T) @ v) @ T`.
    """
    R = T[..., :3, :3]
    result = np.zeros((*T.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = R
    result[..., 3:, :3] = cross_matrix(T[..., :3, 3]) @ R
    return result


def right_jacobian(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the right Jacobians (..., 6, 6) of `pose_from_twist` at twists (..., 6).

    To first order in d, `pose_from_twist(v + d)` equals `pose_from_twist(v) @ pose_from_twist(right_jacobian(v) @ d)`.
    The rotation block is a power series up to the second order, which is accurate for rotations of a few degrees.
    """
    W = cross_matrix(v[..., :3])
    result = np.zeros((*v.shape[:-1], 6, 6))
    result[..., :3, :3] = np.eye(3) - W / 2 + W @ W / 6
    result[..., 3:, 3:] = pose_from_twist(v)[..., :3, :3].swapaxes(-1, -2)
    return result


def mean_pose(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the means (..., 4, 4) of transforms (..., N, 4, 4): mean translation and chordal mean of the rotations."""
    result = np.zeros((*T.shape[:-3], 4, 4))
    result[..., :3, :3] = nearest_rotation(T[..., :3, :3].sum(axis=-3))
    result[..., :3, 3] = T[..., :3, 3].mean(axis=-2)
    result[..., 3, 3] = 1.0
    return result


def nearest_rotation(M: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotations (..., 3, 3) nearest to matrices (..., 3, 3) in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(M)
    handedness = np.ones(M.shape[:-1])
    handedness[..., 2] = np.sign(np.linalg.det(U @ Vt))
    return (U * handedness[..., None, :]) @ Vt


def rotation_angles(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angles (...) of rotations (..., 3, 3), 0 to pi radians. The formula is accurate for small angles."""
    skew = R - R.swapaxes(-1, -2)
    sine = np.sqrt(skew[..., 2, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 0] ** 2)
    return np.arctan2(sine, np.trace(R, axis1=-2, axis2=-1) - 1.0)
