"""Many rigid transforms at once, for the composition of a frame tree."""

from dataclasses import dataclass
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation


@dataclass(frozen=True, eq=False)
class Poses:
    """N rigid transforms between the same two frames."""

    translation: NDArray[np.float64]
    """Translations (N, 3), metres."""
    rotation: Rotation
    """N rotations."""

    def __len__(self) -> int:
        return len(self.translation)

    def __getitem__(self, at: slice | NDArray[np.integer] | NDArray[np.bool_]) -> "Poses":
        return Poses(self.translation[at], self.rotation[cast(Any, at)])

    def __matmul__(self, other: Self) -> "Poses":
        """Compose `T_a_b @ T_b_c` to `T_a_c`, one by one."""
        return Poses(self.translation + self.rotation.apply(other.translation), self.rotation * other.rotation)

    def inverse(self) -> "Poses":
        """Return `T_b_a` for `T_a_b`."""
        rotation = self.rotation.inv()
        return Poses(-rotation.apply(self.translation), rotation)

    def matrix(self, k: int) -> NDArray[np.float64]:
        """Return the k-th transform (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.rotation[k].as_matrix()
        T[:3, 3] = self.translation[k]
        return T

    def distance(self, k: int, other: "Poses") -> tuple[float, float]:
        """Return the largest distance of the others from the k-th, metres and radians. Without others it is 0."""
        if len(other) == 0:
            return 0.0, 0.0
        shift = np.linalg.norm(other.translation - self.translation[k], axis=1)
        turn = (self.rotation[k].inv() * other.rotation).magnitude()
        return float(shift.max()), float(np.max(turn))
