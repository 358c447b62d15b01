"""Names of the simulated cameras. This module imports little, because the command line starts with it."""

import os
from typing import Literal, get_args

CameraName = Literal["oak-d-pro", "oak-d-sr", "d435", "ideal-sr", "ideal", "ideal-measured", "exact"]
CAMERA_NAMES: tuple[CameraName, ...] = get_args(CameraName)
"""Names of all simulated cameras."""
DEFAULT_CAMERA: CameraName = "oak-d-pro"
"""Simulated camera of the simulated cell, of simulated recordings and of the benchmark, if none is chosen."""
PRESET_SUFFIX = ".json"
"""Ending of the name of a camera file, by which it differs from the name of a camera."""


def is_preset_path(name: str | os.PathLike[str]) -> bool:
    """Return whether a camera is given by its file instead of its name."""
    return str(name).lower().endswith(PRESET_SUFFIX)
