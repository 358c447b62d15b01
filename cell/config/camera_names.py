"""Names of the simulated cameras. This module imports little, because the command line starts with it."""

from typing import Literal, get_args

CameraName = Literal["oak-d-pro", "oak-d-sr", "d435", "ideal-sr", "ideal", "ideal-measured", "exact"]
CAMERA_NAMES: tuple[CameraName, ...] = get_args(CameraName)
"""Names of all simulated cameras."""
DEFAULT_CAMERA: CameraName = "oak-d-pro"
"""Simulated camera of the simulated cell, of simulated recordings and of the benchmark, if none is chosen."""
