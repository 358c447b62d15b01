"""Rigid transforms as 4x4 float64 matrices.

`T_base_camera` maps camera points to the base frame: `p_base = T_base_camera @ p_camera`. Products read from left to
right: `T_base_camera = T_base_flange @ T_flange_camera`. `calibration.geometry.se3` has functions for stacks of
transforms. Their results may differ in the last digit.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calibration.geometry.se3 import nearest_rotation

ROTATION_TOLERANCE = 1e-4
"""Maximum deviation of an entry of R^T R from the identity. This deviation moves a point at 1 m by about 0.1 mm. The
rounding of numbers in files causes smaller deviations."""
EXACT_ROTATION_TOLERANCE = 1e-13
"""Maximum deviation of an entry of R^T R from the identity, for a rotation that is exact up to float64 rounding."""


class NotRigidError(ValueError):
    """A matrix or pose is not a rigid transform."""

    slug = "not-rigid"


def rigid(T: ArrayLike, name: str) -> NDArray[np.float64]:
    """Check that a matrix is a rigid transform, and return a float64 copy.

    Args:
        T: (4, 4) array-like. The translation is in metres.
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
    # An overflow gives infinity or NaN, and fails the comparison below.
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
    """Replace the rotation of a rigid transform by the nearest exact rotation.

    A rotation with rounded entries, for example from a file, is not exactly orthonormal.

    Args:
        T: (4, 4) rigid transform.

    Returns:
        (4, 4) rigid transform. `T` is returned unchanged if its rotation is exact to `EXACT_ROTATION_TOLERANCE`.
    """
    R = T[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() <= EXACT_ROTATION_TOLERANCE:
        return T
    result = T.copy()
    result[:3, :3] = nearest_rotation(R)
    return result


def inverse(T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse (4, 4) of a rigid transform (4, 4): `inverse(T_a_b)` is `T_b_a`.

    For stacks of transforms, see `calibration.geometry.se3.invert_poses`.
    """
    result = np.eye(4)
    result[:3, :3] = T[:3, :3].T
    result[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return result


def transform_points(T: NDArray[np.float64], points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Map points (N, 3) by a transform (4, 4). For example, `T_base_camera` maps camera points to the base frame."""
    # For a million points, this formula is ten times as fast as `points @ R.T`.
    return (T[:3, :3] @ points.T).T + T[:3, 3]


def from_quaternion(translation: ArrayLike, quaternion_xyzw: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return the transform of a translation and a rotation quaternion.

    Args:
        translation: (3,) translation, metres.
        quaternion_xyzw: (4,) unit quaternion in the order x, y, z, w.
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
    """Return the transform of a translation and a rotation vector.

    Args:
        translation: (3,) translation, metres.
        rotation_vector: (3,) rotation vector, radians.

    Returns:
        (4, 4) rigid transform.
    """
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(rotation_vector, dtype=np.float64)).as_matrix()
    T[:3, 3] = np.asarray(translation, dtype=np.float64)
    return T
