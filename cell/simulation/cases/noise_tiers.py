"""Tiers of hard depth images: strings with many lost pixels, and depth noise up to where recognition must refuse."""

from dataclasses import replace

import numpy as np

from cell.simulation.cases.case import Case
from cell.simulation.cases.first_tiers import draw_first
from cell.simulation.rendering.depth_camera import camera_model

DROPOUT_SHARES = (0.3, 0.6)
"""Smallest and largest share of the pixels on strings that a case of `speckle` loses."""
NOISE_FACTORS = (1.0, 4.0)
"""Smallest and largest factor on the measured errors of a real camera in a case of `noise`."""


def draw_noisy(tier: str, seed: int, rng: np.random.Generator) -> Case:
    """Draw the case of the tier `speckle` or `noise`, with the scenes of `paper` and `long` in turn.

    Args:
        tier: Name of the tier.
        seed: Seed of the case. Pairs of `speckle` cases have independent lost pixels and blobs in turn.
        rng: Generator of the scene and of the errors.

    Raises:
        SceneError: The scene cannot be laid.
    """
    case = draw_first(("paper", "long")[seed % 2], seed, rng)
    camera = case.camera if tier == "speckle" else camera_model("ideal-measured")
    assert camera.noise is not None
    if tier == "speckle":
        share = float(rng.uniform(*DROPOUT_SHARES))
        noise = replace(camera.noise, string_dropout_share=share, string_dropout_blobs=seed // 2 % 2 == 1)
    else:
        noise = camera.noise.scaled(float(rng.uniform(*NOISE_FACTORS)))
    return replace(case, tier=tier, camera=replace(camera, noise=noise))
