"""Tiers of strings that lie close together: side by side in contact, and dense tangles."""

import numpy as np

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene


def draw_crowded(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a case of the tiers `side` and `dense`.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene.

    Raises:
        SceneError: The scene cannot be laid.
    """
    scene_seed = int(rng.integers(2**31))
    if tier == "side":
        radius_m = float(rng.choice([0.003, 0.0042, 0.005]))
        scene = make_scene("side-by-side", scene_seed, radius_m, float(rng.uniform(0.35, 0.5)), strings=seed % 2 + 1)
        return Case(tier, seed, scene, camera_model("ideal"), PoseErrors())
    strings = int(rng.integers(2, 5))
    crossings = int(rng.integers(10, 21))
    length_m = (0.6 + 0.12 * crossings) / strings
    scene = make_scene("tangle", scene_seed, 0.003, length_m, crossings=crossings, strings=strings)
    return Case(tier, seed, scene, camera_model("ideal", (800, 500)), PoseErrors())
