"""Detection of flange rotations that were read in a wrong convention.

A controller reports a rotation as three or four numbers. In a wrong convention they still give a proper rotation, so no
single pose shows the mistake. Here the numbers of each view are recovered from its matrix and read in each convention.
There are several candidates for a view, since angles are known up to whole turns. In the right convention, one
candidate for each view gives the same angles between the views as the camera observed.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

EULER_ORDERS = ("xyz", "zyx", "XYZ", "ZYX", "zyz", "ZYZ")
"""Orders as in `scipy.spatial.transform.Rotation`: small letters for fixed axes, capital letters for rotating ones."""
MAX_COMBINATIONS = 4000
"""Maximum number of combinations of candidates. More means that the angles do not distinguish them."""


@dataclass(frozen=True)
class Misreading:
    """A wrong convention."""

    code: str
    """Code of the finding."""
    description: str
    """What the rotations are, and as what they were read."""
    candidates: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """Returns for a given rotation (3, 3) the rotations (K, 3, 3) that it may mean."""


def reinterpret_rotations(
    R: NDArray[np.float64], observed: NDArray[np.float64], tolerance_rad: float
) -> Iterator[tuple[Misreading, NDArray[np.float64]]]:
    """Yield each wrong convention that explains the rotations, with the rotations that they mean.

    Args:
        R: (N, 3, 3) rotations as given.
        observed: (N, 3, 3) rotations by the camera. Only the angles between them count.
        tolerance_rad: Maximum difference of an angle, radians.
    """
    for guess in MISREADINGS:
        corrected = _consistent_choice([guess.candidates(rotation) for rotation in R], observed, tolerance_rad)
        if corrected is not None:
            yield guess, corrected


def _consistent_choice(
    candidates: list[NDArray[np.float64]], observed: NDArray[np.float64], tolerance_rad: float
) -> NDArray[np.float64] | None:
    """Choose one candidate of each view (N, 3, 3) such that all angles between views are those of `observed`."""
    # Each row holds a choice for the views so far.
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
    """Return the angles (...) between rotations (..., 3, 3), radians."""
    trace = np.einsum("...ij,...ij->...", first, second)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def _as_degrees(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the candidates for a rotation vector in degrees that was read as radians, with lost whole turns added."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle > 0 else vector
    lengths = angle + 2 * np.pi * np.arange(-29, 29)
    lengths = lengths[np.abs(lengths) <= 181.0]
    return Rotation.from_rotvec(np.radians(lengths)[:, None] * axis).as_matrix()


def _vector_as_euler(R: NDArray[np.float64], order: str) -> NDArray[np.float64]:
    """Return the candidates for a rotation vector that was read as Euler angles."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(R).as_euler(order)
    # Two sets of angles give the same rotation.
    flipped = np.pi - angles[1] if order[0].lower() != order[2].lower() else -angles[1]
    vectors = np.array([angles, [angles[0] + np.pi, flipped, angles[2] + np.pi]])
    return Rotation.from_rotvec((vectors + np.pi) % (2 * np.pi) - np.pi).as_matrix()


def _euler_as_vector(R: NDArray[np.float64], order: str) -> NDArray[np.float64]:
    """Return the candidates for Euler angles that were read as a rotation vector."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vector)
    vectors = np.array([vector, vector * (1 - 2 * np.pi / angle)]) if angle > 0 else vector[None]
    return Rotation.from_euler(order, vectors).as_matrix()


def _quaternion_order(R: NDArray[np.float64], first: int) -> NDArray[np.float64]:
    """Return the candidate for a quaternion whose real part was taken from the wrong end."""
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
