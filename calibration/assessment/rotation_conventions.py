"""Detection of flange rotations that were read in a wrong convention.

A controller reports a rotation as three or four numbers. Read in a wrong convention, the numbers still give a proper
rotation, so a single pose does not show the mistake. This module recovers the numbers of each view from the rotation
matrix and reads the numbers in every other convention. Whole turns are lost in a rotation matrix, so each view has
several candidates for the true rotation. In the right convention, one candidate per view gives the same rotation angles
between views as the camera observed.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

EULER_ORDERS = ("xyz", "zyx", "XYZ", "ZYX", "zyz", "ZYZ")
"""Euler orders as in `scipy.spatial.transform.Rotation`: lower case for fixed axes, upper case for rotating axes."""
MAX_COMBINATIONS = 4000
"""Maximum number of candidate combinations. If more combinations fit, the angles do not distinguish the candidates."""


@dataclass(frozen=True)
class Misreading:
    """A wrong convention in which rotations may have been read."""

    code: str
    """Code of the finding."""
    description: str
    """True convention of the rotations, and the convention in which they were read."""
    candidates: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """Function that returns the candidates (K, 3, 3) for the true rotation, given the rotation (3, 3) as read."""


def reinterpret_rotations(
    R: NDArray[np.float64], observed: NDArray[np.float64], tolerance_rad: float
) -> Iterator[tuple[Misreading, NDArray[np.float64]]]:
    """Yield each wrong convention that explains the rotations, with the true rotations (N, 3, 3).

    Args:
        R: (N, 3, 3) flange rotations as read.
        observed: (N, 3, 3) rotations observed by the camera. Only the rotation angles between views are used.
        tolerance_rad: Maximum difference between a true and an observed rotation angle, radians.
    """
    for guess in MISREADINGS:
        corrected = _consistent_choice([guess.candidates(rotation) for rotation in R], observed, tolerance_rad)
        if corrected is not None:
            yield guess, corrected


def _consistent_choice(
    candidates: list[NDArray[np.float64]], observed: NDArray[np.float64], tolerance_rad: float
) -> NDArray[np.float64] | None:
    """Choose one candidate of each view by its rotation angles to the other views.

    The angle between two chosen rotations must equal the angle between the rotations of these views in `observed`
    (N, 3, 3).

    Return the chosen rotations (N, 3, 3). Return None if no combination fits, or too many fit.
    """
    # Each row of `chosen` is one combination for the views so far.
    chosen = candidates[0][:, None]
    for view in range(1, len(observed)):
        angles = _angles(chosen[:, None], candidates[view][None, :, None])  # (rows, candidates, earlier views)
        expected = _angles(observed[:view], observed[view])
        rows, picks = np.nonzero((np.abs(angles - expected) < tolerance_rad).all(axis=2))
        if len(rows) == 0 or len(rows) > MAX_COMBINATIONS:
            return None
        chosen = np.concatenate([chosen[rows], candidates[view][picks, None]], axis=1)
    return chosen[0]


def _angles(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation angles (...) between `first` (..., 3, 3) and `second` (..., 3, 3), radians."""
    trace = np.einsum("...ij,...ij->...", first, second)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def _as_degrees(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the candidates (K, 3, 3) if a rotation vector in degrees was read as radians. Whole turns are added."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle > 0 else vector
    lengths = angle + 2 * np.pi * np.arange(-29, 29)
    lengths = lengths[np.abs(lengths) <= 181.0]
    return Rotation.from_rotvec(np.radians(lengths)[:, None] * axis).as_matrix()


def _vector_as_euler(R: NDArray[np.float64], order: str) -> NDArray[np.float64]:
    """Return the candidates (2, 3, 3) if a rotation vector was read as Euler angles of this `order`."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(R).as_euler(order)
    # Two sets of Euler angles give the same rotation.
    first, second, third = angles
    is_symmetric = order[0].lower() == order[2].lower()
    flipped = -second if is_symmetric else np.pi - second
    vectors = np.array([angles, [first + np.pi, flipped, third + np.pi]])
    return Rotation.from_rotvec((vectors + np.pi) % (2 * np.pi) - np.pi).as_matrix()


def _euler_as_vector(R: NDArray[np.float64], order: str) -> NDArray[np.float64]:
    """Return the candidates (K, 3, 3) if Euler angles of this `order` were read as a rotation vector."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vector)
    vectors = vector[None]
    if angle > 0:  # The longer rotation vector of the opposite direction gives the same rotation.
        vectors = np.array([vector, vector * (1 - 2 * np.pi / angle)])
    return Rotation.from_euler(order, vectors).as_matrix()


def _quaternion_order(R: NDArray[np.float64], first: int) -> NDArray[np.float64]:
    """Return the candidate (1, 3, 3) if the real part of a quaternion was read at the wrong end.

    A cyclic shift by `first` brings the quaternion into the order x, y, z, w.
    """
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(Rotation.from_matrix(R).as_quat(), first)).as_matrix()[None]


MISREADINGS = (
    Misreading("degrees", "rotation vectors in degrees that were read as radians", _as_degrees),
    *(
        Misreading(
            "euler-angles",
            f"rotation vectors that were read as Euler angles {order}",
            partial(_vector_as_euler, order=order),
        )
        for order in EULER_ORDERS
    ),
    *(
        Misreading(
            "euler-angles",
            f"Euler angles {order} that were read as rotation vectors",
            partial(_euler_as_vector, order=order),
        )
        for order in EULER_ORDERS
    ),
    Misreading(
        "quaternion-order", "quaternions w, x, y, z that were read as x, y, z, w", partial(_quaternion_order, first=-1)
    ),
    Misreading(
        "quaternion-order", "quaternions x, y, z, w that were read as w, x, y, z", partial(_quaternion_order, first=1)
    ),
)
"""All wrong conventions, in the order in which they are tried."""
