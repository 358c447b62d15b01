"""The parabola through the end of a line: where it is, where it leads, and how it bends."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.polyline import arc_length

DISTURBED = 0.55
"""Up to this far from the end, in radii, points are drawn aside by what lies beside it."""
DISTURBED_WEIGHT = 0.25
BENT = 3.0
"""A shorter line, in radii, shows no bend."""


def fit_end_parabola(line: NDArray[np.float64], length: float, r: float) -> NDArray[np.float64]:
    """(3, 3) terms of the parabola through the first `length` (metres) of `line` (N, 3), N at least 2.

    A point at arc length s from the line's first point is near `terms[0] + s terms[1] + s**2 terms[2]`.
    """
    s = arc_length(line)
    n = max(int(np.searchsorted(s, length)) + 1, 2)
    s, points = s[:n], line[:n]
    weight = np.where((s < DISTURBED * r) & (len(s) > 4), DISTURBED_WEIGHT, 1.0)
    degree = 2 if len(s) > 4 and s[-1] > BENT * r else 1
    # Of a line all in one place, least squares takes the parabola that stays there.
    terms, *_ = np.linalg.lstsq(weight[:, None] * np.vander(s, degree + 1, increasing=True), weight[:, None] * points)
    return np.vstack([terms, np.zeros((2 - degree, 3))]).astype(np.float64)
