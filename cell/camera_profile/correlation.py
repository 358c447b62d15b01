"""Correlation length of an error image: how far the error of a pixel is shared by its neighbours."""

import numpy as np
from numpy.typing import NDArray

MAX_LAG_PX = 30
"""Largest distance of pixels that are compared."""
HALF = 0.5
"""Share of the covariance at which the correlation length is taken."""
MIN_PAIRS = 1000
"""Smallest number of pixel pairs for a covariance."""


def correlation_length_px(errors: list[NDArray[np.float32]], axis: int) -> float | None:
    """Return the distance at which the covariance of an error falls to half of that of one pixel, pixels.

    Args:
        errors: Error images (H, W), not a number where the error is unknown. Their mean is zero.
        axis: 0 compares pixels of one column, 1 pixels of one row.

    Returns:
        The interpolated distance, at most `MAX_LAG_PX`. None if the errors are zero or too few pixels are known.
    """
    first = _covariance(errors, axis, 0)
    if first is None or first <= 0:
        return None
    before = 1.0
    for lag in range(1, MAX_LAG_PX + 1):
        covariance = _covariance(errors, axis, lag)
        if covariance is None:
            return None
        now = covariance / first
        if now < HALF:
            return lag - 1 + (before - HALF) / (before - now)
        before = now
    return float(MAX_LAG_PX)


def _covariance(errors: list[NDArray[np.float32]], axis: int, lag: int) -> float | None:
    """Return the mean product of the errors of two pixels at a distance, or None if there are too few pairs."""
    total = 0.0
    count = 0
    for error in errors:
        length = error.shape[axis]
        if lag >= length:
            return None
        along = np.moveaxis(error, axis, 0)
        product = along[: length - lag] * along[lag:]
        total += float(np.nansum(product, dtype=np.float64))
        count += int(np.isfinite(product).sum())
    return total / count if count >= MIN_PAIRS else None
