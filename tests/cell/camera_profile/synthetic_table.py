"""Depth images of a tilted table with known errors."""

from dataclasses import dataclass

import numpy as np

from cell.camera_profile.measure import PoseImages

SIZE = 200, 320
FOCAL_BASELINE = 30.0
UNIT_M = 1e-5
K = np.array([[200.0, 0.0, 159.5], [0.0, 200.0, 99.5], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Errors:
    """Errors of a synthetic camera, disparities."""

    temporal: float = 0.0
    locking: float = 0.0
    fixed: float = 0.0
    fixed_blur_px: float = 0.0
    warp: float = 0.0
    hole_share: float = 0.0
    flicker_share: float = 0.0


def table_images(errors: Errors, images: int = 5, tilt: float = 0.3, seed: int = 0) -> PoseImages:
    """Return images of a table about 0.45 m away."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    v, u = np.indices(SIZE)
    disparity = FOCAL_BASELINE / 0.45 * (1 + tilt * (u - 160) / 200 + 0.1 * (v - 100) / 200)
    slow = np.cos(2 * np.pi * (u + 0.5) / SIZE[1])
    still = disparity + errors.locking * np.sin(2 * np.pi * disparity) + np.sqrt(2) * errors.warp * slow
    fixed = rng.standard_normal(SIZE)
    if errors.fixed_blur_px > 0:
        fixed = gaussian_filter(fixed, errors.fixed_blur_px)
    still += errors.fixed * fixed / fixed.std()
    lost = rng.random(SIZE) < errors.hole_share
    taken = []
    for _ in range(images):
        disparities = still + errors.temporal * rng.standard_normal(SIZE)
        missing = lost | (rng.random(SIZE) < errors.flicker_share)
        depth = np.rint(FOCAL_BASELINE / disparities / UNIT_M)
        taken.append(np.where(missing, 0, depth).astype(np.uint16))
    return PoseImages(np.stack(taken), UNIT_M, K)
