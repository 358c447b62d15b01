"""Tier of thin strings, seen with all pixels of the camera from as near as it measures."""

from dataclasses import replace

import numpy as np

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene

DISTANCE_M = (0.33, 0.35)
"""Smallest and largest distance of the camera. Nearer than 0.32 m, its extended disparities end."""


def draw_thin(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a case with one string of r = 1 or 1.5 mm, in turn.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene.

    Raises:
        SceneError: The scene cannot be laid.
    """
    radius_m = (0.001, 0.0015)[seed % 2]
    scene = make_scene("random", int(rng.integers(2**31)), radius_m, 0.25, crossings=int(rng.integers(3)))
    camera = replace(camera_model("ideal", (1280, 800)), working_m=DISTANCE_M)
    return Case(tier, seed, scene, camera, PoseErrors())
