"""How the simulated camera learns where the arm carries it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

PoseSource = Callable[[], NDArray[np.float64]]
"""Tells the flange pose (4, 4) in the base frame at the moment of the call. Raises OSError."""


def controller_pose(host: str) -> PoseSource:
    """The flange pose as the virtual controller at `host` tells it. Raises OSError."""
    from cell.simulation.controller.admin import AdminClient

    return AdminClient(host).pose
