"""Thinning of the centre line point cloud (section III.B)."""

import numpy as np
from numpy.typing import NDArray

from recognition.geometry.neighbours import neighbourhood_means
from recognition.parameters import ChainParameters


def thin(points: NDArray[np.float64], parameters: ChainParameters) -> NDArray[np.float64]:
    """(N, 3) points, each moved to the mean of its neighbours within r_c, itself included (eq. 3)."""
    return neighbourhood_means(points, points, points, parameters.r_c)
