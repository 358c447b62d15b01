"""What a camera sees from where: nominal figures, for planning viewpoints only.

The scan itself takes the pinhole matrix that comes with each frame.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cell.config.camera_config import OakCamera, OakProduct, SimulatedCamera
from cell.config.cell_config import AnyCamera
from cell.config.strict_model import Range


@dataclass(frozen=True, eq=False)
class CameraOptics:
    """The depth image of a camera."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    height: int
    near_m: float
    """Nothing nearer is measured."""
    working_m: Range
    """Distances (nearest, farthest) from which strings are well seen."""


@dataclass(frozen=True)
class _Stereo:
    """A pair of cameras, as its maker describes it."""

    focal_px: float
    """After rectification, of an image 1280 pixels wide."""
    baseline_m: float
    focus_m: float = 0.196
    """Nearest distance in focus."""


_SENSOR_WIDTH = 1280
_DISPARITIES = 95
"""Largest disparity that the camera looks for, pixels; with extended disparity twice that."""
_MARGIN = 1.12
"""How far beyond the nearest measurable distance the working range begins: strings stand up, arms are not exact."""
_COARSEST_M_PER_PX = 0.0105
"""Depth of one pixel of disparity where the working range ends. A fifth of a pixel is then 2 mm."""

_STEREO: dict[OakProduct, _Stereo] = {
    "oak-d": _Stereo(882.5, 0.075),
    "oak-d-pro": _Stereo(805.0, 0.075),
    "oak-d-sr": _Stereo(763.0, 0.020, focus_m=0.20),
    "oak4-d": _Stereo(805.0, 0.075),
}
"""By Luxonis' product pages and its depth tutorial: fields of view across of 72, 77 (rectified), 80 and 77 degrees,
baselines, the 19.6 cm from which the OV9282's lens is in focus, and the 95 disparities searched."""


def camera_optics(camera: AnyCamera) -> CameraOptics:
    """What viewpoints are planned with: of a simulated camera exactly, of a real one by its product's data sheet."""
    if isinstance(camera, SimulatedCamera):
        from cell.simulation.rendering.depth_camera import camera_model

        model = camera_model(camera.model)
        return CameraOptics(model.K, model.width, model.height, model.near_m, camera.working_m or model.working_m)
    return _oak(camera)


def baseline_m(product: OakProduct) -> float:
    """How far apart the two lenses of that product are."""
    return _STEREO[product].baseline_m


def _oak(camera: OakCamera) -> CameraOptics:
    stereo = _STEREO[camera.product]
    focal_px = stereo.focal_px * camera.width / _SENSOR_WIDTH
    focal_baseline = focal_px * stereo.baseline_m
    near = max(focal_baseline / (_DISPARITIES * (2 if camera.extended_disparity else 1)), stereo.focus_m)
    nearest = _MARGIN * near
    farthest = max(float(np.sqrt(_COARSEST_M_PER_PX * focal_baseline)), 1.1 * nearest)
    K = np.array(
        [
            [focal_px, 0.0, (camera.width - 1) / 2],
            [0.0, focal_px, (camera.height - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )
    return CameraOptics(K, camera.width, camera.height, near, camera.working_m or (nearest, farthest))
