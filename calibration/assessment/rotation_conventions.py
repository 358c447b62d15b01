"""Rotations that were read by a wrong rule: what they were told as, and which reading fits the camera's.

A controller tells a direction as three numbers. Read by another rule than they were written by, they give a proper
rotation, only another one, and no single pose shows it. For each view the three numbers are worked out again from the
matrix - there are some possibilities, as angles come back without their whole turns - and read by the rule in
question; if that was it, one choice for each view makes all turns between views as large as the camera saw them.
"""

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

EULER_ORDERS = ("xyz", "zyx", "XYZ", "ZYX", "zyz", "ZYZ")
"""As in `scipy.spatial.transform.Rotation`: about fixed axes in small letters, about turned ones in large."""
MOST_CHOICES = 4000
"""Combinations followed at once: more means that the turns tell nothing."""


@dataclass(frozen=True)
class Misreading:
    """A wrong rule."""

    code: str
    words: str
    """What the rotations look like."""
    readings: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """(3, 3) as given -> (K, 3, 3) what it may have meant."""


def reinterpret_rotations(
    R: NDArray[np.float64], seen: NDArray[np.float64], tolerance_rad: float
) -> Iterator[tuple[Misreading, NDArray[np.float64]]]:
    """Each wrong rule that may explain rotations `R` (N, 3, 3), by the turns `seen` (N, 3, 3) between them, with the
    rotations (N, 3, 3) as they were meant."""
    for guess in MISREADINGS:
        meant = _agreeing([guess.readings(rotation) for rotation in R], seen, tolerance_rad)
        if meant is not None:
            yield guess, meant


def _agreeing(
    readings: list[NDArray[np.float64]], seen: NDArray[np.float64], tolerance_rad: float
) -> NDArray[np.float64] | None:
    """(N, 3, 3) one reading of each view, such that the turns between all are as large as those of `seen`."""
    # Each row: the readings chosen of the views so far.
    chosen = readings[0][:, None]
    for view in range(1, len(seen)):
        turns = _angles(chosen[:, None], readings[view][None, :, None])  # (rows, readings, views before)
        expected = _angles(seen[:view], seen[view])
        rows, picks = np.nonzero((np.abs(turns - expected) < tolerance_rad).all(axis=2))
        if len(rows) == 0 or len(rows) > MOST_CHOICES:
            return None
        chosen = np.concatenate([chosen[rows], readings[view][picks, None]], axis=1)
    return chosen[0]


def _angles(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    trace = np.einsum("...ij,...ij->...", first, second)
    return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))


def _as_degrees(R: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation vectors in degrees, read as radians: whole turns were lost, and a long vector may look reversed."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle > 0 else vector
    lengths = angle + 2 * np.pi * np.arange(-29, 29)
    lengths = lengths[np.abs(lengths) <= 181.0]
    return Rotation.from_rotvec(np.radians(lengths)[:, None] * axis).as_matrix()


def _vector_as_euler(R: NDArray[np.float64], order: str) -> NDArray[np.float64]:
    """Rotation vectors, read as Euler angles."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(R).as_euler(order)
    # Two sets of angles give the same rotation.
    flipped = np.pi - angles[1] if order[0].lower() != order[2].lower() else -angles[1]
    vectors = np.array([angles, [angles[0] + np.pi, flipped, angles[2] + np.pi]])
    return Rotation.from_rotvec((vectors + np.pi) % (2 * np.pi) - np.pi).as_matrix()


def _euler_as_vector(R: NDArray[np.float64], order: str) -> NDArray[np.float64]:
    """Euler angles, read as a rotation vector."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(R).as_rotvec()
    angle = np.linalg.norm(vector)
    vectors = np.array([vector, vector * (1 - 2 * np.pi / angle)]) if angle > 0 else vector[None]
    return Rotation.from_euler(order, vectors).as_matrix()


def _quaternion_order(R: NDArray[np.float64], first: int) -> NDArray[np.float64]:
    """Quaternions whose real part was taken from the wrong end."""
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
"""In the order in which they are tried."""
