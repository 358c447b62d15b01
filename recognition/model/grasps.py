"""Grasps of a model. Metres and radians, base frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Grasp:
    """A pose in which a parallel gripper can grasp a string."""

    chain: int
    """Id of the chain."""
    s_m: float
    """Arc length along the chain, metres."""
    T_base_grasp: NDArray[np.float64]
    """(4, 4) grasp pose in the base frame, metres. The origin lies on the centre line. z is the approach direction, and
    x is the closing direction: across the string, to the left of the chain direction. A rotation by pi about z gives an
    equivalent grasp."""
    opening_m: float
    """Distance between the fingers before they close, metres."""
    reach_m: float
    """Distance of the fingertips beyond the origin, along z, metres."""
    clearance_m: float
    """Minimum distance of fingers and palm from other strands and objects during the approach, metres. Distances
    above 0.03 are reported as 0.03."""
    table_clearance_m: float
    """Minimum distance of the fingertips from the table, or from an object under them, metres."""
    score: float
    """Quality of the grasp, from 0 to 1 (best)."""
    trusted: bool = True
    """Whether no doubt concerns the part of the string between the fingers."""
