"""Depth camera that ray-casts a string scene.

The depth is matched in rendered images, or exact depth with the errors of a noise model.
"""

import math
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import rigid
from cell.camera.frame_averaging import mean_image, median
from cell.config.camera_names import is_preset_path
from cell.config.camera_optics import DOT_PROJECTORS, STEREO_BASELINES_M, CameraName, simulated_optics
from cell.config.camera_preset import DISPARITY_STEP, CameraPreset, read_preset
from cell.config.rendering_options import RenderingOptions, TableTop
from cell.simulation.rendering.appearance import appearance_of_seed
from cell.simulation.rendering.calibration_board import Print
from cell.simulation.rendering.image_cache import ImageCache, image_key
from cell.simulation.rendering.image_renderer import ImageRenderer, Scenery
from cell.simulation.rendering.lighting import LIGHT_STREAM, draw_lamp
from cell.simulation.rendering.materials import Materials
from cell.simulation.rendering.meshes import scene_meshes
from cell.simulation.rendering.ray_caster import RayCaster
from cell.simulation.rendering.stereo_camera import StereoCamera, StereoPair, StillPair
from cell.simulation.rendering.stereo_matching import StereoMatching
from cell.simulation.rendering.stereo_noise import (
    MEDIAN_OF_FIVE,
    StereoNoise,
    StillImage,
    device_warp,
    drop_pixels,
    expose,
    still_image,
)
from cell.simulation.scenes.scenes import StringScene

DEVICE_STREAM = 9
"""Stream of a seed from which the errors of one device are drawn."""
EXPOSURES = 5
"""Number of exposures of a capture."""


class CameraModelError(ValueError):
    """The camera does not exist, or does not have the resolution."""

    slug = "camera-model"


@dataclass(frozen=True)
class CameraModel:
    """Geometry and noise of a simulated camera."""

    name: str
    focal_px: float
    """Focal length of the depth image, pixels."""
    width: int
    height: int
    near_m: float
    """Smallest distance that the camera measures."""
    working_m: tuple[float, float]
    """Smallest and largest distance from which strings are seen well."""
    noise: StereoNoise | None
    """Error model of exact depth, or None for no errors apart from rounding to the unit."""
    depth_unit_m: float = 0.0001
    stereo: StereoPair | None = None
    """Cameras whose rendered images the depth is matched in, or None. `noise` is None with such cameras."""
    sensor: tuple[int, int] = (1280, 800)
    """Width and height of the largest depth image, pixels."""
    table_top: TableTop | None = None
    """Table top in rendered images, unless options give another one. None means that it is drawn from the seed."""

    def complete(self, options: RenderingOptions) -> RenderingOptions:
        """Return the options with the table top of this camera, if they have none."""
        return replace(options, table_top=options.table_top or self.table_top)

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) pinhole matrix. Pixel centres have integer coordinates."""
        return np.array(
            [
                [self.focal_px, 0.0, (self.width - 1) / 2],
                [0.0, self.focal_px, (self.height - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )


_MEASURED: dict[str, Any] = {"warp_px": 0.3, "edge_hole_share": 0.15, "flicker_share": 0.25, "patches": 1.0}
"""Errors of real OAK-D cameras: a warp of some tenths of a pixel, 10 to 19 % holes within 8 pixels of a rim, 2 to 9 %
of all pixels flickering, and patches of up to 10 pixels on weak texture."""
_MIN_WIDTH = 32
"""Smallest width of a depth image, pixels."""
_MIN_HEIGHT = 20
"""Smallest height of a depth image, pixels."""


def _preset(name: CameraName, noise: StereoNoise | None) -> CameraModel:
    optics = simulated_optics(name, None)
    focal_px = float(optics.K[0, 0])
    return CameraModel(name, focal_px, optics.width, optics.height, optics.near_m, optics.working_m, noise)


def _stereo_preset(name: CameraName, disparities: int) -> CameraModel:
    pair = StereoPair(STEREO_BASELINES_M[name], disparities, has_dots=name in DOT_PROJECTORS)
    return replace(_preset(name, None), stereo=pair)


CAMERAS = {
    model.name: model
    for model in (
        _stereo_preset("oak-d-pro", 96),
        _stereo_preset("oak-d-sr", 80),
        replace(_stereo_preset("d435", 128), depth_unit_m=0.001, sensor=(1280, 720)),
        _preset("ideal-sr", StereoNoise(763.0, 0.020, hole_share=0.03)),
        _preset("ideal", StereoNoise(805.0, 0.075, hole_share=0.02)),
        _preset("ideal-measured", StereoNoise(805.0, 0.075, hole_share=0.02, **_MEASURED)),
        _preset("exact", None),
    )
}
"""Presets of cameras.

`oak-d-pro`, `oak-d-sr` and `d435` match their depth in rendered images. `oak-d-pro` searches the 96 disparities of the
device; the others search as many as their nearest distance needs. The three `ideal` presets have the depth of
`StereoNoise`. `ideal` has the figures of an OAK-D Pro: a baseline of 75 mm, extended disparity and every second pixel.
`ideal-sr` has those of an OAK-D SR: 20 mm and all pixels. `ideal-measured` is `ideal` with the errors of real OAK-D
cameras.
"""


def camera_model(name: str, resolution: tuple[int, int] | None = None) -> CameraModel:
    """Return a preset, or the same camera with another resolution of its depth image.

    The horizontal field of view stays. A camera with rendered images renders and matches them at the resolution, with
    the same errors in pixels. The noise models match the sensor's 1280x800 pixels for every resolution, so their error
    in metres does not depend on it.

    Args:
        name: Name of the preset, or path of a camera file.
        resolution: Width and height of the depth image, or None for those of the preset.

    Raises:
        CameraModelError: The name is unknown, or the sensor does not have the resolution.
        CameraPresetError: The file cannot be read, or is no camera file.
    """
    model = camera_of_preset(read_preset(name)) if is_preset_path(name) else CAMERAS.get(name)
    if model is None:
        raise CameraModelError(
            f"there is no camera model {name!r}; known are {', '.join(CAMERAS)}, and files of `pointchain "
            "camera-profile`, whose names end with .json"
        )
    if resolution is None:
        return model
    width, height = resolution
    max_width, max_height = model.sensor
    aspect = model.height / model.width
    if not (_MIN_WIDTH <= width <= max_width and _MIN_HEIGHT <= height <= min(max_height, width * aspect)):
        raise CameraModelError(
            f"{name} has no depth image of {width}x{height}; choose a size from {_MIN_WIDTH}x{_MIN_HEIGHT} to "
            f"{max_width}x{max_height}, no higher than {aspect:.3f} of the width"
        )
    scale = width / model.width
    scaled = replace(model, focal_px=model.focal_px * scale, width=width, height=height)
    if model.stereo is None:
        return scaled
    steps = math.ceil(model.stereo.disparities * scale / DISPARITY_STEP)
    return replace(scaled, stereo=replace(model.stereo, disparities=steps * DISPARITY_STEP))


def camera_of_preset(preset: CameraPreset) -> CameraModel:
    """Return the camera of a file."""
    base = CAMERAS[preset.base]
    assert base.stereo is not None
    pair = replace(
        base.stereo,
        baseline_m=preset.baseline_m,
        disparities=preset.disparities,
        matching=replace(base.stereo.matching, block_px=preset.block_px),
        bias_px=preset.bias_px,
        warp_px=preset.warp_px,
        row_error_px=preset.row_error_px,
        noise_factor=preset.noise_factor,
    )
    return replace(
        base,
        name=preset.name,
        focal_px=preset.focal_px,
        width=preset.width,
        height=preset.height,
        near_m=preset.near_m,
        working_m=preset.working_m,
        depth_unit_m=preset.depth_unit_m,
        stereo=pair,
        sensor=(preset.width, preset.height),
        table_top=preset.table_top,
    )


def draw_bias_px(model: CameraModel, rng: np.random.Generator) -> float:
    """Draw the disparity error of a session, pixels, which is 0 for a camera without errors."""
    if model.stereo is not None:
        return model.stereo.bias_px * float(rng.standard_normal())
    if model.noise is not None:
        return model.noise.bias_px * float(rng.standard_normal())
    return 0.0


def image_provenance(model: CameraModel, options: RenderingOptions, seed: int) -> dict[str, str]:
    """Return what the rendered images of a camera show, for a recording. It is empty without rendered images.

    Args:
        model: Camera.
        options: Options of the images.
        seed: Seed of the device.
    """
    if model.stereo is None:
        return {}
    appearance = appearance_of_seed(model.complete(options), seed)
    return {"sheath": appearance.sheath, "table_top": appearance.table_top, "ir_dots": f"{options.ir_dots:g}"}


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Surfaces that the ray through the centre of each pixel hits."""

    depth: NDArray[np.float32]
    """Depth (H, W) along the optical axis, metres; infinite without a hit."""
    part: NDArray[np.int64]
    """Index (H, W) of the mesh in `meshes.scene_meshes`; -1 without a hit."""
    normals: NDArray[np.float32]
    """Unit normal (H, W, 3) of the mesh, on either side, scene frame; zero without a hit."""
    points: NDArray[np.float32]
    """Point (H, W, 3) in the scene frame; the camera's position without a hit."""


@dataclass(frozen=True, eq=False)
class StillView:
    """What a camera without rendered images sees from one pose."""

    depth: NDArray[np.float32]
    """Exact depth (H, W), metres; infinite without a hit."""
    still: StillImage | None
    """Depth with all errors except those of each exposure, or None for an exact camera."""


@dataclass(frozen=True, eq=False)
class CameraImages:
    """Images of an exposure or of a capture."""

    depth: NDArray[np.uint16]
    """Depth image (H, W), in depth units; 0 = not measured."""
    intensity: NDArray[np.uint8] | None
    """Left image (H, W) that the depth was matched in, or None without rendered images."""


@dataclass(frozen=True, eq=False)
class ImageContent:
    """What rendered images show, apart from the scene."""

    options: RenderingOptions = field(default_factory=RenderingOptions)
    """Materials and dots."""
    board: Print | None = None
    """Print on the first object beside the strings, or None."""


class DepthCamera:
    """A camera and a scene. It is built once and captures from many poses."""

    def __init__(
        self,
        model: CameraModel,
        scene: StringScene,
        bias_px: float = 0.0,
        device_seed: int = 0,
        content: ImageContent | None = None,
        cache: ImageCache | None = None,
    ) -> None:
        """Build the scene for ray casting.

        Args:
            model: Geometry, and errors or stereo cameras.
            scene: Strings and other objects on the table.
            bias_px: Disparity error of the session, pixels.
            device_seed: Seed of the device's errors, and of light and materials in rendered images.
            content: What rendered images show, or None for the defaults.
            cache: Keeps rendered images between runs; None: they are not kept.

        Raises:
            RenderingOptionsError: The camera does not have the options of the content.
        """
        self.model = model
        self.bias_px = bias_px
        self._scene = scene
        self._device_seed = device_seed
        self._content = ImageContent() if content is None else content
        self._cache = cache
        has_dots = model.stereo is not None and model.stereo.has_dots
        self._content.options.check(model.name, model.stereo is not None, has_dots)
        self._warp = None
        if model.noise is not None:
            rng = np.random.default_rng([device_seed, DEVICE_STREAM])
            self._warp = device_warp(model.noise, (model.height, model.width), rng)
        self._caster = RayCaster(scene)
        self.strings = len(scene.curves)
        """Number of meshes that are strings, which come first."""
        u, v = np.meshgrid(np.arange(model.width), np.arange(model.height))
        # not of unit length, so that the distance along a ray is the depth along the optical axis
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(model.K).T
        self._rays = rays.astype(np.float32)

    @cached_property
    def _stereo(self) -> StereoCamera:
        """Cameras for the images. They are made for the first image, because their textures take time."""
        model = self.model
        seed = self._device_seed
        assert model.stereo is not None
        options = self._content.options
        materials = Materials(self._scene, appearance_of_seed(model.complete(options), seed), seed)
        lamp = draw_lamp(np.random.default_rng([seed, LIGHT_STREAM]))
        scenery = Scenery(self._caster, materials, lamp, self._content.board, self.strings)
        renderer = ImageRenderer(scenery, model.K, model.width, model.height)
        return StereoCamera(model.stereo, renderer, self.bias_px, seed, options.ir_dots)

    def with_matching(self, matching: StereoMatching, noise_factor: float) -> "DepthCamera":
        """Return the same device with another matching and another noise of its sensors.

        What `still_view` returned holds for both. The camera must match its depth in rendered images.
        """
        assert self.model.stereo is not None
        other = copy(self)
        pair = replace(self.model.stereo, matching=matching, noise_factor=noise_factor)
        other.model = replace(self.model, stereo=pair)
        other._stereo = self._stereo.with_matching(matching, noise_factor)
        return other

    @cached_property
    def _scene_key(self) -> str:
        """Hash of what rendered images from all poses depend on."""
        board = self._content.board
        options = self._content.options
        parts: list[NDArray[np.generic] | str | float | None] = [self.strings, *self._scene.curves]
        for vertices, triangles in scene_meshes(self._scene):
            parts += [vertices, triangles]
        parts += [self.model.K, self.model.width, self.model.height, repr(self.model.stereo)]
        parts += [
            self.bias_px,
            self._device_seed,
            repr(appearance_of_seed(self.model.complete(options), self._device_seed)),
            options.ir_dots,
        ]
        if board is not None:
            parts += [repr(board.board), board.T_scene_board]
        return image_key(*parts)

    def _rendered_pair(self, T_base_camera: NDArray[np.float64], with_dots: bool) -> StillPair:
        """Return both images from a pose, from the cache if they are there."""
        if self._cache is None:
            return self._stereo.render(T_base_camera, with_dots)
        key = image_key(self._scene_key, T_base_camera, with_dots)
        shape = (self.model.height, self.model.width)
        return self._cache.get(key, shape, lambda: self._stereo.render(T_base_camera, with_dots))

    def render(self, T_base_camera: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Return the exact depth (H, W) and the index of the string in each pixel (H, W).

        The depth is along the optical axis, in metres, and infinite without a hit. The index is -1 without a string.

        Args:
            T_base_camera: Camera pose (4, 4) in the scene.
        """
        hits = self._caster.cast_rays(self._rays_from(T_base_camera))
        # the unsigned value for no hit is far beyond the indices of strings
        part = hits["geometry_ids"].astype(np.int64)
        return hits["t_hit"], np.where(part < self.strings, part, -1)

    def surfaces(self, T_base_camera: NDArray[np.float64]) -> Surfaces:
        """Return the surfaces in front of the camera, for an intensity image."""
        rays = self._rays_from(T_base_camera)
        hits = self._caster.cast_rays(rays)
        depth = hits["t_hit"]
        seen = np.isfinite(depth)
        points = rays[..., :3] + np.where(seen, depth, np.float32(0))[..., None] * rays[..., 3:]
        part = np.where(seen, hits["geometry_ids"].astype(np.int64), -1)
        return Surfaces(depth, part, hits["primitive_normals"], points)

    def _rays_from(self, T_base_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return origin and direction of each ray (H, W, 6)."""
        T = rigid(T_base_camera, "T_base_camera")
        rays = np.empty((*self._rays.shape[:2], 6), dtype=np.float32)
        rays[..., :3] = T[:3, 3]
        rays[..., 3:] = self._rays @ T[:3, :3].T.astype(np.float32)
        return rays

    def capture(self, T_base_camera: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return the depth image (H, W) of a capture, in depth units; 0 = not measured. See `capture_images`."""
        return self.capture_images(T_base_camera, rng).depth

    def capture_images(self, T_base_camera: NDArray[np.float64], rng: np.random.Generator) -> CameraImages:
        """Return the images of a capture: the median of the depth of five exposures, and the mean of their left images.

        The noise model computes the median in one step.

        Args:
            T_base_camera: Camera pose (4, 4) in the scene.
            rng: Generator of the noise.
        """
        still = self.still_view(T_base_camera, rng)
        if not isinstance(still, StillPair):
            return CameraImages(self._counts(self._noisy(still, rng, MEDIAN_OF_FIVE)), None)
        exposures = [self.expose_images(still, rng) for _ in range(EXPOSURES)]
        left_images = [exposure.intensity for exposure in exposures if exposure.intensity is not None]
        return CameraImages(median([exposure.depth for exposure in exposures]), mean_image(left_images))
        return self.combine(self.still_view(T_base_camera, rng), rng)

    def combine(self, still: StillView | StillPair, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return the depth image (H, W) of a capture from a pose, in depth units; 0 = not measured.

        Args:
            still: What all exposures from the pose share.
            rng: Generator of the noise.
        """
        if isinstance(still, StillPair):
            return median([self.expose(still, rng) for _ in range(EXPOSURES)])
        return self._counts(self._noisy(still, rng, MEDIAN_OF_FIVE))

    def still_view(
        self, T_base_camera: NDArray[np.float64], rng: np.random.Generator, with_dots: bool = True
    ) -> StillView | StillPair:
        """Return what all exposures from a pose share, a pair of images for a camera with rendered images.

        Args:
            T_base_camera: Camera pose (4, 4) in the scene.
            rng: Generator of the errors of this pose in the noise model.
            with_dots: Whether the dot projector is on, if it has power.
        """
        if self.model.stereo is not None:
            return self._rendered_pair(T_base_camera, with_dots and self._content.options.ir_dots > 0)
        depth, string = self.render(T_base_camera)
        if self.model.noise is None:
            return StillView(depth, None)
        still = still_image(depth, self.model.focal_px, self.model.noise, self.bias_px, rng, self._warp)
        return StillView(depth, drop_pixels(still, string >= 0, self.model.noise, rng))

    def expose(self, still: StillView | StillPair, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return the depth image (H, W) of one exposure, in depth units; 0 = not measured. See `expose_images`."""
        return self.expose_images(still, rng).depth

    def expose_images(self, still: StillView | StillPair, rng: np.random.Generator) -> CameraImages:
        """Return the images of one exposure.

        Args:
            still: What all exposures from the pose share.
            rng: Generator of the noise.
        """
        if isinstance(still, StillPair):
            exposure = self._stereo.expose(still, rng)
            return CameraImages(self._counts(exposure.depth_m), exposure.left)
        return CameraImages(self._counts(self._noisy(still, rng, 1.0)), None)

    def _noisy(self, still_view: StillView, rng: np.random.Generator, frame_share: float) -> NDArray[np.float32]:
        """Return the depth (H, W), metres, with the errors of an exposure times `frame_share`."""
        if self.model.noise is None or still_view.still is None:
            return still_view.depth
        return expose(still_view.still, self.model.noise, rng, frame_share)

    def _counts(self, depth: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Return a depth image (H, W) in depth units. 0 is not measured, too near or too far."""
        counts = np.rint(np.where(np.isfinite(depth), depth, 0.0) / self.model.depth_unit_m)
        seen = (depth >= self.model.near_m) & (counts <= np.iinfo(np.uint16).max)
        return np.where(seen, counts, 0).astype(np.uint16)
