"""Tier of scans with one to four views, as a fixed camera or a short scan gives them."""

from dataclasses import replace

import numpy as np

from cell.planning.look_at import Bearing
from cell.simulation.cases.case import Case
from cell.simulation.cases.first_tiers import draw_first

MAX_VIEWS = 4
"""Largest number of views."""
FIXED_ELEVATIONS_RAD = (np.deg2rad(45.0), np.deg2rad(88.0))
"""Range of the elevation of a single view: a fixed camera looks obliquely, or nearly straight down."""
WORKSPACE_MARGIN_M = 0.03
"""Distance from the strings to the border of the workspace. A cell with few views has a workspace that they show."""
SCENES = ("paper", "long", "many")
"""Tiers whose scenes are taken in turn."""


def draw_few(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a case with one to four views in turn. A single view has a random bearing, more views are on two rings.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene and of the bearing.

    Raises:
        SceneError: The scene cannot be laid.
    """
    views = 1 + seed % MAX_VIEWS
    case = draw_first(SCENES[seed // MAX_VIEWS % len(SCENES)], seed, rng)
    half_m = float(np.abs(np.vstack(case.scene.curves)[:, :2]).max()) + WORKSPACE_MARGIN_M
    case = replace(case, tier=tier, views=views, workspace_half_m=half_m)
    if views > 1:
        return case
    azimuth, roll = rng.uniform(-np.pi, np.pi, 2)
    return replace(case, bearings=(Bearing(azimuth, rng.uniform(*FIXED_ELEVATIONS_RAD), roll),))
