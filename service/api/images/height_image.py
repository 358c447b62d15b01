"""Image of a height map for people, coloured by height above the table."""

import numpy as np

from service.api.images.height_colours import colour_heights
from service.processing.height_map_file import StoredHeightMap


def draw_heights(stored: StoredHeightMap) -> bytes:
    """Return a height map as a PNG with one pixel for each cell: x to the right, y up. Unmeasured is transparent."""
    import cv2

    height_m = stored.heights.z_m.T[::-1] - stored.table_z_m
    measured = np.isfinite(height_m)
    opacity = np.where(measured, 255, 0).astype(np.uint8)
    image = np.dstack([colour_heights(np.where(measured, height_m, 0.0)), opacity])
    return cv2.imencode(".png", image)[1].tobytes()
