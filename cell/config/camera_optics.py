"""Facts about the supported cameras: their nominal optics, and the frame rates of the OAK products.

Viewpoints are planned with the nominal optics. A scan takes the pinhole matrix of each frame instead.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cell.config.camera_names import CameraName
from cell.config.strict_model import Range

OakProduct = Literal["oak-d", "oak-d-pro", "oak-d-sr", "oak4-d"]


@dataclass(frozen=True, eq=False)
class CameraOptics:
    """Geometry and working range of a depth image."""

    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    """Width of the depth image, pixels."""
    height: int
    """Height of the depth image, pixels."""
    near_m: float
    """Smallest distance that the camera measures."""
    working_m: Range
    """Smallest and largest distance from which strings are seen well."""


@dataclass(frozen=True)
class _Stereo:
    """A stereo pair, as its data sheet describes it."""

    focal_px: float
    """Focal length after rectification, for an image of 1280 pixels width."""
    baseline_m: float
    """Distance between the two lenses."""
    focus_m: float = 0.196
    """Smallest distance in focus."""


_SENSOR_WIDTH = 1280
_DISPARITIES = 95
"""Largest disparity of the stereo search, pixels. Extended disparity doubles it."""
_MARGIN = 1.12
"""Ratio of the nearest working distance and the nearest measurable one: strings stand up, and arms are not exact."""
_COARSEST_M_PER_PX = 0.0105
"""Depth of one pixel of disparity at the end of the working range. A fifth of a pixel is then 2 mm."""

_STEREO: dict[OakProduct, _Stereo] = {
    "oak-d": _Stereo(882.5, 0.075),
    "oak-d-pro": _Stereo(805.0, 0.075),
    "oak-d-sr": _Stereo(763.0, 0.020, focus_m=0.20),
    "oak4-d": _Stereo(805.0, 0.075),
}
"""Figures of Luxonis' product pages and depth tutorial: horizontal fields of view of 72, 77 (rectified), 80 and 77
degrees, baselines, the 19.6 cm from which the lens of an OV9282 is in focus, and the 95 disparities of the search."""


_STEREO_FPS = {
    "left-right check": (105.0, 55.0),
    "subpixel": (96.0, 34.0),
    "extended disparity": (62.0, 26.0),
}
"""Depth images/s of an RVC2 at each of `_STEREO_PIXELS`, with the left-right check and the named mode.

Source: https://docs.luxonis.com/projects/api/en/latest/components/nodes/stereo_depth/, section "Stereo depth FPS"
(luxonis/depthai-python, pull request 527). The vendor measured with a median filter of 5x5, which is off here.
"""
_STEREO_PIXELS = 640 * 400, 1280 * 720
_NEURAL_FPS = 42.0
"""Depth images/s of the neural stereo matching of an RVC4 with its default model, 480x300.

Source: release notes of depthai 3.2.0, https://github.com/luxonis/depthai-core/releases/tag/v3.2.0. The other stereo
matching of an RVC4 gives 60 with 1280x800 (https://docs.luxonis.com/hardware/platform/rvc/rvc4).
"""


def simulated_optics(name: CameraName, working_m: Range | None) -> CameraOptics:
    """Return the optics of a simulated camera.

    Args:
        name: Name of the preset.
        working_m: Configured working range, or None for the range of the preset.
    """
    focal_px, width, height, near_m, preset_m = _SIMULATED[name]
    return CameraOptics(_pinhole(focal_px, width, height), width, height, near_m, working_m or preset_m)


_SIMULATED: dict[CameraName, tuple[float, int, int, float, Range]] = {
    "oak-d-pro": (402.5, 640, 400, 0.32, (0.36, 0.60)),
    "oak-d-sr": (763.0, 1280, 800, 0.20, (0.25, 0.40)),
    "d435": (424.0, 848, 480, 0.20, (0.30, 0.50)),
    "ideal-sr": (763.0, 1280, 800, 0.20, (0.25, 0.40)),
    "ideal": (402.5, 640, 400, 0.32, (0.36, 0.60)),
    "ideal-measured": (402.5, 640, 400, 0.32, (0.36, 0.60)),
    "exact": (440.0, 640, 400, 0.10, (0.25, 0.60)),
}
"""Focal length, width and height in pixels, nearest distance and working range in metres.

The figures of the OAK products are those of `_STEREO`. Those of the D435 are of Intel's datasheet of the D400 series:
a baseline of 50 mm, depth images 87 degrees wide with a tolerance of 3 degrees, and 19.5 cm as smallest distance with
848x480. Intel's guide "Tuning depth cameras for best performance" gives a focal length of about 645 pixels for
1280x720, which is 427 for 848x480.
"""

STEREO_BASELINES_M: dict[CameraName, float] = {
    "oak-d-pro": _STEREO["oak-d-pro"].baseline_m,
    "oak-d-sr": _STEREO["oak-d-sr"].baseline_m,
    "d435": 0.050,
}
"""Distance between the lenses of the simulated cameras whose depth is matched in rendered images."""
DOT_PROJECTORS: tuple[CameraName, ...] = ("oak-d-pro", "d435")
"""Simulated cameras with a dot projector."""


def oak_optics(
    product: OakProduct, width: int, height: int, extended_disparity: bool, working_m: Range | None
) -> CameraOptics:
    """Return the optics of an OAK camera by the data sheet of its product.

    Args:
        product: Product name.
        width: Width of the depth image, pixels.
        height: Height of the depth image, pixels.
        extended_disparity: Whether the stereo search is extended, which measures shorter distances.
        working_m: Configured working range, or None for the range that follows from the data sheet.
    """
    stereo = _STEREO[product]
    focal_px = stereo.focal_px * width / _SENSOR_WIDTH
    focal_baseline = focal_px * stereo.baseline_m
    near = max(focal_baseline / (_DISPARITIES * (2 if extended_disparity else 1)), stereo.focus_m)
    nearest = _MARGIN * near
    farthest = max(float(np.sqrt(_COARSEST_M_PER_PX * focal_baseline)), 1.1 * nearest)
    return CameraOptics(_pinhole(focal_px, width, height), width, height, near, working_m or (nearest, farthest))


def oak_max_fps(product: OakProduct, width: int, height: int, extended_disparity: bool) -> float:
    """Return the largest frame rate of the depth images by the tables of the vendor, whole images/s.

    The time of an image is linear in its pixels, through the two resolutions of the table. The table does not have
    extended disparity together with subpixel. Subpixel then takes the same time as without extended disparity.

    Args:
        product: Product name.
        width: Width of the depth image, pixels.
        height: Height of the depth image, pixels.
        extended_disparity: Whether the stereo search is extended.
    """
    if product == "oak4-d":
        return _NEURAL_FPS
    checked_s, subpixel_s, extended_s = (1 / np.array(fps) for fps in _STEREO_FPS.values())
    times_s = extended_s + subpixel_s - checked_s if extended_disparity else subpixel_s
    few, many = _STEREO_PIXELS
    share = (width * height - few) / (many - few)
    return float(math.floor(1 / (times_s[0] + share * (times_s[1] - times_s[0]))))


def baseline_m(product: OakProduct) -> float:
    """Return the distance between the two lenses of the product."""
    return _STEREO[product].baseline_m


def _pinhole(focal_px: float, width: int, height: int) -> NDArray[np.float64]:
    return np.array([[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]])
