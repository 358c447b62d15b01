"""Rigid transforms as 4x4 float64 matrices.

`T_base_camera` maps camera points to base: `p_base = T_base_camera @ p_camera`, and chains read from
left to right: `T_base_camera = T_base_flange @ T_flange_camera`. `calibration.geometry.se3` has the stacked versions,
which differ from these in the last digit.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.geometry.se3 import nearest_rotation

ROTATION_TOLERANCE = 1e-4
"""Maximum deviation of R^T R from the identity. It is 0.1 mm at one metre, above the rounding of any file format."""
EXACT_ROTATION_TOLERANCE = 1e-13
"""Maximum deviation of R^T R from the identity in a rotation that is exact except for the rounding of float64."""


class NotRigidError(ValueError):
    """Raised for a matrix that should be a rigid transform and is not."""

    slug = "not-rigid"


def rigid(T: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return `T` as a float64 matrix after checking that it is a rotation and a translation.

    Args:
        T: (4, 4) matrix, or anything that NumPy converts to one. The translation is in metres.
        name: Name of the transform in the error message.

    Returns:
        (4, 4) copy of the matrix.

    Raises:
        NotRigidError: The shape is wrong, an entry is not finite, the last row is not (0, 0, 0, 1), or the matrix is
            mirrored, scaled or sheared.
    """
    try:
        matrix = np.array(T, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise NotRigidError(f"{name} is not a matrix of numbers: {error}") from error
    if matrix.shape != (4, 4):
        raise NotRigidError(f"{name} has shape {matrix.shape}; a 4x4 matrix is needed")
    if not np.isfinite(matrix).all():
        raise NotRigidError(f"{name} holds NaN or infinity")
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise NotRigidError(f"{name} has the last row {matrix[3].tolist()}; it must be [0, 0, 0, 1]")
    R = matrix[:3, :3]
    # Entries that overflow give NaN, which fails the comparison below.
    with np.errstate(over="ignore", invalid="ignore"):
        deviation = np.abs(R.T @ R - np.eye(3)).max()
        scale = np.linalg.norm(R) / np.sqrt(3.0)
    if not deviation <= ROTATION_TOLERANCE:
        raise NotRigidError(
            f"{name} is not rigid: its axes deviate from unit length and right angles by {deviation:.3g} "
            f"(mean scale {scale:.4g}); check the units and that the matrix is not transposed"
        )
    if np.linalg.det(R) < 0:
        raise NotRigidError(f"{name} is mirrored (determinant -1): an axis is flipped")
    return matrix


def with_nearest_rotation(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a rigid transform with its rotation replaced by the nearest exact rotation.

    A matrix with rounded entries is only approximately a rotation.

    Args:
        T: (4, 4) rigid transform.

    Returns:
        (4, 4) rigid transform. It is `T` itself if the rotation is exact to `EXACT_ROTATION_TOLERANCE`.
    """
    R = T[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() <= EXACT_ROTATION_TOLERANCE:
        return T
    result = T.copy()
    result[:3, :3] = nearest_rotation(R)
    return result


def inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse (4, 4) of a rigid transform (4, 4): `inverse(T_a_b)` is `T_b_a`.

    `calibration.geometry.se3.invert_poses` inverts a stack.
    """
    result = np.eye(4)
    result[:3, :3] = T[:3, :3].T
    result[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return result


def transform_points(T: NDArray[np.float64], points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the points (N, 3) mapped by `T` (4, 4). `T_base_camera` maps camera points to the base frame."""
    # For a million points this is ten times as fast as `points @ R.T`.
    return (T[:3, :3] @ points.T).T + T[:3, 3]


def from_quaternion(translation: ArrayLike, quaternion_xyzw: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return the transform with a given translation and rotation quaternion.

    Args:
        translation: (3,) metres.
        quaternion_xyzw: (4,) x, y, z, w, with the real part last.
        name: Name of the transform in the error message.

    Returns:
        (4, 4) rigid transform.

    Raises:
        NotRigidError: A number is not finite, or the length of the quaternion differs from 1 by more than 1e-3.
    """
    from scipy.spatial.transform import Rotation

    t = np.asarray(translation, dtype=np.float64)
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    if not (np.isfinite(t).all() and np.isfinite(q).all()):
        raise NotRigidError(f"{name} holds NaN or infinity")
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(q))
    if abs(norm - 1.0) > 1e-3:
        raise NotRigidError(f"{name} has a rotation quaternion of length {norm:.4g}; it must be 1")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(q).as_matrix()
    T[:3, 3] = t
    return T


def to_quaternion(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of `T` (4, 4) as a quaternion (4,) in the order x, y, z, w."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(T[:3, :3]).as_quat()


def rotation_angle(T: NDArray[np.float64]) -> float:
    """Return the rotation angle of `T` (4, 4), 0 to pi radians."""
    from scipy.spatial.transform import Rotation

    return float(Rotation.from_matrix(T[:3, :3]).magnitude())


def from_rotation_vector(translation: ArrayLike, rotation_vector: ArrayLike) -> NDArray[np.float64]:
    """Return the transform (4, 4) with a translation (3,), metres, and a rotation vector (3,), radians."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(rotation_vector, dtype=np.float64)).as_matrix()
    T[:3, 3] = np.asarray(translation, dtype=np.float64)
    return T
