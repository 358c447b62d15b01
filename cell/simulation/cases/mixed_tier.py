"""Tier of strings of different radii that cross each other. The given radius is that of the thinnest string."""

import numpy as np

from cell.simulation.cases.case import Case
from cell.simulation.pose_errors import PoseErrors
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.layout import Draft, SceneError, SceneRequest
from cell.simulation.scenes.placement import lay_down
from cell.simulation.scenes.random_walk import CourseSettings, wander
from cell.simulation.scenes.scenes import StringScene
from cell.simulation.scenes.stacking_heights import HeightsError

RADIUS_M = (0.003, 0.004)
"""Smallest and largest radius of the thinnest string, metres."""
THICKER = (1.25, 1.5, 2.0)
"""Radii of the other strings, relative to that of the thinnest one."""
LENGTH_M = (0.3, 0.5)
"""Shortest and longest length of a string, metres."""
MAX_CROSSINGS = 4
"""Largest number of crossings of all strings."""
CLEARANCE = 3.0
"""Smallest distance of the centre lines of strands that do not cross, in radii of the thickest string."""


def draw_mixed(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw the case of the tier `mixed`: two or three strings, of which the first is the thinnest.

    Args:
        tier: Name of the tier.
        seed: Seed of the case. The relative radii of the second string take turns.
        rng: Generator of the scene.

    Raises:
        SceneError: The scene cannot be laid.
    """
    radius_m = float(rng.uniform(*RADIUS_M))
    others = [THICKER[seed % len(THICKER)], *rng.choice(THICKER, int(rng.integers(2)))]
    radii_m = [radius_m, *(float(radius_m * share) for share in others)]
    lengths_m = [float(length_m) for length_m in rng.uniform(*LENGTH_M, len(radii_m))]
    crossings = int(rng.integers(MAX_CROSSINGS + 1))
    plan = wander(rng, lengths_m, CourseSettings(max(radii_m), CLEARANCE), crossings)
    if plan is None:
        raise SceneError(f"{tier}: could not lay {len(radii_m)} strings with {crossings} crossings")
    request = SceneRequest(tier, radius_m, max(lengths_m), 1.0, crossings, len(radii_m), CLEARANCE)
    try:
        curves = lay_down(rng, Draft(plan, lengths_m, radii_m, crossings), request)
    except HeightsError as error:
        raise SceneError(f"{tier}: {error}") from error
    scene = StringScene(f"{tier}-{seed}", radius_m, tuple(curves), radii_m=tuple(radii_m))
    return Case(tier, seed, scene, camera_model("ideal"), PoseErrors())
