"""Grasps of a model. Metres and radians, base frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class GraspMotion:
    """Poses of the flange (4, 4) that carry out a grasp, as `T_base_flange`, metres."""

    pregrasp: NDArray[np.float64]
    """Pose in front of the grasp, back along the approach direction. The gripper opens here."""
    grasp: NDArray[np.float64]
    """Pose at which the fingers close."""
    retreat: NDArray[np.float64]
    """Pose after the lift, back along the approach direction."""


@dataclass(frozen=True, eq=False)
class ScoredGrasp:
    """A pose in which a parallel gripper can grasp a string, before the grasps of the scene are listed."""

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


@dataclass(frozen=True, eq=False, kw_only=True)
class Grasp(ScoredGrasp):
    """A grasp of a model, with what lies near it along the string and how to carry it out."""

    id: int
    """Number of the grasp in the model, from 0, in the order of the list."""
    cluster: int
    """Number of the cluster of neighbouring grasps on a chain, from 0, in the order of the best grasp of each."""
    sigma_m: float
    """Largest standard deviation of the centre line between the fingers, across the string, metres."""
    end_distance_m: float | None
    """Distance to the nearest end, along the string, metres. None on a ring."""
    over_distance_m: float | None
    """Distance to the nearest crossing at which this strand is the upper one, along the string, metres, or None."""
    under_distance_m: float | None
    """Distance to the nearest crossing at which this strand is the lower one, along the string, metres, or None."""
    chains_above: tuple[int, ...]
    """Ids of the chains that are lifted with the string, because they lie over it near the grasp."""
    object_above_m: float | None
    """Height of the lowest object above the string near the grasp, from the grasp on, metres. None if there is none
    within the lift."""
    T_base_flange: GraspMotion
    """Poses of the flange that carry out the grasp."""
