"""Tier of scenes on a table that is not where the recording states it."""

from dataclasses import replace

import numpy as np

from calibration.geometry.transforms import from_rotation_vector
from cell.simulation.cases.case import Case
from cell.simulation.cases.first_tiers import draw_first

OFFSETS_M = (0.002, 0.010)
"""Range of the distances of the table above or below the stated height, metres."""
TILTS_DEG = (0.3, 2.0)
"""Range of the tilts of the table, degrees."""
KINDS = ("offset", "tilt", "offset and tilt")
"""What is wrong about the table: its height at the middle of the workspace, its tilt, or both."""


def draw_lifted(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw a scene of the tier `paper` or `long`, in turn, on a table that is higher, lower or tilted.

    Args:
        tier: Name of the tier.
        seed: Seed of the case.
        rng: Generator of the scene and of the table.

    Raises:
        SceneError: The scene cannot be laid.
    """
    case = draw_first(("paper", "long")[seed % 2], seed, rng)
    kind = str(rng.choice(KINDS))
    offset_m = float(rng.choice([-1, 1]) * rng.uniform(*OFFSETS_M)) if "offset" in kind else 0.0
    tilt_rad = float(np.deg2rad(rng.uniform(*TILTS_DEG))) if "tilt" in kind else 0.0
    direction = rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(direction), np.sin(direction), 0.0])
    return replace(case, tier=tier, T_base_table=from_rotation_vector((0.0, 0.0, offset_m), tilt_rad * axis))
