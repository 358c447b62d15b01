"""Intensity images for views of simulated cameras that render none."""

from dataclasses import replace

import numpy as np

from cell.devices import View


def with_intensity(view: View) -> View:
    """Return a view with an intensity image of noise, different for each index."""
    noise = np.random.default_rng(view.index).integers(0, 256, view.depth.shape, dtype=np.uint8)
    return replace(view, intensity=noise)
