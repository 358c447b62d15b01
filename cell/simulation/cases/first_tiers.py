"""Tiers of scenes that lie on the stated table, with strings of one radius: from the paper's scene to fixtures."""

from dataclasses import replace

import numpy as np

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.low_obstacles import KINDS
from cell.simulation.scenes.scenes import make_scene
from cell.simulation.scenes.strand_clearance import MIN_SIDE_CLEARANCE, SIDE_CLEARANCE

MEASURED_ERRORS = PoseErrors(robot_m=0.0001, robot_rad=0.0002, smooth_m=0.0006, smooth_rad=float(np.deg2rad(0.15)))
"""Pose errors of the tier `measured`. Real arms have a repeatability below 0.1 mm, and an error of 0.3 to 1.2 mm that
changes smoothly with the pose."""


def draw_first(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw the case of one of the tiers `paper` to `fixtures`.

    Args:
        tier: Name of the tier.
        seed: Seed of the case. Tiers with several kinds of scenes take them in turn.
        rng: Generator of the scene.

    Raises:
        SceneError: The scene cannot be laid.
    """
    if tier == "measured":
        case = draw_first(("paper", "long")[seed % 2], seed, rng)
        return replace(case, tier=tier, camera=camera_model("ideal-measured"), errors=MEASURED_ERRORS)
    scene_seed = int(rng.integers(2**31))
    camera, errors = camera_model("ideal"), PoseErrors()
    match tier:
        case "paper":
            scene = make_scene("random", scene_seed, crossings=int(rng.integers(3)))
        case "long":
            scene = make_scene("random", scene_seed, length_m=0.7, crossings=int(rng.integers(2, 5)))
        case "many":
            scene = make_scene("several", scene_seed, length_m=0.32)
        case "physical":
            clearance = float(rng.choice([SIDE_CLEARANCE, MIN_SIDE_CLEARANCE]))
            crossings = int(rng.integers(1, 3))
            scene = make_scene("settled", scene_seed, length_m=0.47, crossings=crossings, clearance=clearance)
        case "soft":
            scene = make_scene("random", scene_seed, crossings=int(rng.integers(1, 3)), softness=0.6)
        case "photo":
            camera = camera_model("ideal", (800, 500))
            strings = int(rng.integers(1, 4))
            max_crossings = (4, 7, 10)[strings - 1]
            crossings = int(rng.integers(strings, max_crossings + 1))
            # The total length of all strings grows with the number of crossings.
            total_m = float(rng.uniform(0.5, 1.2) + 0.25 * (strings - 1) + 0.1 * crossings)
            scene = make_scene("tangle", scene_seed, 0.003, total_m / strings, crossings=crossings, strings=strings)
        case "fixtures":
            radius_m = float(rng.choice([0.003, 0.0042, 0.005]))
            scene = make_scene(KINDS[seed % len(KINDS)], scene_seed, radius_m)
        case _:
            errors = errors.scaled(2.0)
            if seed % 3 == 0:
                camera = camera_model("ideal-sr")
                scene = make_scene("random", scene_seed, crossings=int(rng.integers(1, 3)))
            elif seed % 3 == 1:
                scene = make_scene("random", scene_seed, 0.003, 0.54, crossings=int(rng.integers(1, 4)), clutter=4)
            else:
                scene = make_scene("random", scene_seed, length_m=1.0, crossings=5)
    return Case(tier, seed, scene, camera, errors)
