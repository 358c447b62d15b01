"""Stereo camera: both images of a scene, and the depth that matching measures in them.

The left camera is the reference of the depth. The matching window of a real camera mixes string and table, which lowers
strings and widens them; an error model on exact depth does not have that.
"""

from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cell.simulation.rendering.image_renderer import ImageRenderer, PixelShift, develop
from cell.simulation.rendering.lighting import DotProjector
from cell.simulation.rendering.stereo_matching import StereoMatching, match

MIN_DISPARITY_PX = 0.5
"""Smallest measurable disparity."""

_WARP_ORDER = 3
"""Number of half periods of the rectification error across the image."""
_RECTIFICATION_STREAM = 11
"""Stream of a device's seed from which its rectification error is drawn."""
_DOTS_STREAM = 12
"""Stream of a device's seed from which its dot pattern is drawn."""


@dataclass(frozen=True)
class StereoPair:
    """Two cameras side by side, and their matching."""

    baseline_m: float
    """Distance between the cameras."""
    disparities: int
    """Number of whole disparities of the search, a multiple of 16."""
    matching: StereoMatching = field(default_factory=StereoMatching)
    """Settings of the matching."""
    bias_px: float = 0.1
    """Standard deviation of the disparity bias, which is constant during a session."""
    warp_px: float = 0.15
    """Root mean square of the slow disparity error over the image, constant for one device."""
    row_error_px: float = 0.12
    """Root mean square of the slow difference between the rows of both images, constant for one device."""
    has_dots: bool = False
    """Whether the camera has a dot projector."""
    noise_factor: float = 1.0
    """Factor on the noise of the image sensors."""


@dataclass(frozen=True, eq=False)
class StillPair:
    """Both images from one pose in grey levels (H, W), without noise."""

    left: NDArray[np.float32]
    right: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class StereoExposure:
    """One exposure of both cameras."""

    depth_m: NDArray[np.float32]
    """Depth (H, W) of the left image along its optical axis, metres; 0 = not measured."""
    left: NDArray[np.uint8]
    """Left image (H, W)."""


class StereoCamera:
    """A stereo camera in front of a scene."""

    def __init__(
        self,
        pair: StereoPair,
        renderer: ImageRenderer,
        bias_px: float = 0.0,
        device_seed: int = 0,
        ir_dots: float = 0.0,
    ) -> None:
        """Draw the errors of the device.

        Args:
            pair: Cameras and matching.
            renderer: Camera of both images.
            bias_px: Bias of the session, pixels of disparity.
            device_seed: Seed of the device's errors.
            ir_dots: Power of the dot projector, 0 to 1. 0 turns it off.
        """
        self._pair = pair
        self._renderer = renderer
        shape = (renderer.height, renderer.width)
        rng = np.random.default_rng([device_seed, _RECTIFICATION_STREAM])
        columns = slow_field(shape, pair.warp_px, rng) - np.float32(bias_px)
        self._shift = PixelShift(columns, slow_field(shape, pair.row_error_px, rng))
        self._dots = None
        if ir_dots > 0 and pair.has_dots:
            self._dots = DotProjector(ir_dots, np.random.default_rng([device_seed, _DOTS_STREAM]))

    def with_matching(self, matching: StereoMatching, noise_factor: float) -> "StereoCamera":
        """Return the same device with another matching and another noise of its sensors."""
        other = copy(self)
        other._pair = replace(self._pair, matching=matching, noise_factor=noise_factor)
        return other

    def render(self, T_scene_camera: NDArray[np.float64], with_dots: bool = True) -> StillPair:
        """Return both images from a pose.

        Args:
            T_scene_camera: Pose (4, 4) of the left camera.
            with_dots: Whether the dot projector is on, if it has power.
        """
        dots = self._dots if with_dots else None
        baseline_m = self._pair.baseline_m
        T_right = _moved_right(T_scene_camera, baseline_m)
        T_projector = _moved_right(T_scene_camera, baseline_m / 2)
        left = self._renderer.render(T_scene_camera, None, dots, T_projector)
        right = self._renderer.render(T_right, self._shift, dots, T_projector)
        return StillPair(left, right)

    def expose(self, still: StillPair, rng: np.random.Generator) -> StereoExposure:
        """Return one exposure: both images with the noise of the sensor, and the depth matched in them."""
        left = develop(still.left, rng, self._pair.noise_factor)
        right = develop(still.right, rng, self._pair.noise_factor)
        disparity = match(left, right, self._pair.disparities, self._pair.matching)
        measured = disparity > MIN_DISPARITY_PX
        focal_baseline = np.float32(self._renderer.K[0, 0] * self._pair.baseline_m)
        depth_m = np.where(measured, focal_baseline / np.where(measured, disparity, np.float32(1)), np.float32(0))
        return StereoExposure(depth_m, left)


def _moved_right(T: NDArray[np.float64], distance_m: float) -> NDArray[np.float64]:
    """Return a pose (4, 4) moved along its own x axis."""
    moved = T.copy()
    moved[:3, 3] += distance_m * T[:3, 0]
    return moved


def slow_field(shape: tuple[int, int], rms: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a random field (H, W) of zero mean that varies slowly over the image.

    It is a sum of cosines with up to three half periods across the image, as the residuals of a rectification are.
    """
    orders = np.arange(_WARP_ORDER + 1)
    rows = np.cos(np.pi * np.outer(orders, (np.arange(shape[0]) + 0.5) / shape[0]))
    columns = np.cos(np.pi * np.outer(orders, (np.arange(shape[1]) + 0.5) / shape[1]))
    weights = rng.standard_normal((len(orders), len(orders)))
    weights[0, 0] = 0.0
    slow = rows.T @ weights @ columns
    return (rms * slow / np.sqrt(np.mean(slow**2))).astype(np.float32)
