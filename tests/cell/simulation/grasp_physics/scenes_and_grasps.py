"""Scenes and grasps for the tests of the physics."""

import numpy as np
from numpy.typing import NDArray

from cell.simulation.grasp_physics.trial import PlannedGrasp
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene

RADIUS_M = 0.0042
REACH_M = 0.0022
"""Reach of the fingertips with 2 mm between them and the table."""


def straight_scene(*offsets_m: float, boxes: tuple[Box, ...] = ()) -> StringScene:
    """Return straight strings of 0.3 m along x, at y = 0 and at the given offsets."""
    x = np.linspace(-0.15, 0.15, 301)
    curves = [np.column_stack([x, np.full_like(x, y), np.full_like(x, RADIUS_M)]) for y in (0.0, *offsets_m)]
    return StringScene("straight", RADIUS_M, tuple(curves), boxes)


def upright_grasp(x_m: float = 0.0, y_m: float = 0.0, raised_m: float = 0.0, opening_m: float = 0.0124) -> PlannedGrasp:
    """Return a grasp from above on the string at y = 0. The fingers close along y."""
    return PlannedGrasp(0, x_m + 0.15, upright_pose(x_m, y_m, RADIUS_M + raised_m), opening_m, REACH_M)


def upright_pose(x_m: float, y_m: float, z_m: float) -> NDArray[np.float64]:
    """Return a pose (4, 4) with z down, x along -y of the base frame, and y along x of the base frame."""
    T = np.eye(4)
    T[:3, :3] = np.column_stack([(0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0)])
    T[:3, 3] = x_m, y_m, z_m
    return T
