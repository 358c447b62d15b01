"""Colours of heights above the table, for images that people look at: low is blue, high is yellow."""

import numpy as np
from numpy.typing import NDArray

MIN_HEIGHT_M, MAX_HEIGHT_M = -0.003, 0.027
"""Heights above the table at the ends of the colour scale. Values outside have the colour of the nearer end."""


def colour_heights(height_m: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return the colours (M, N, 3) of heights (M, N) above the table, metres, in the order blue, green, red."""
    import cv2

    share = np.clip((height_m - MIN_HEIGHT_M) / (MAX_HEIGHT_M - MIN_HEIGHT_M), 0.0, 1.0)
    return np.asarray(cv2.applyColorMap((share * 255).astype(np.uint8), cv2.COLORMAP_CIVIDIS), dtype=np.uint8)
