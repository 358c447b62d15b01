"""Depth camera that ray-casts a string scene."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import rigid
from cell.config.camera_optics import CameraName, simulated_optics
from cell.simulation.rendering import meshes
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
    """Error model, or None for exact depth apart from rounding to the unit."""
    depth_unit_m: float = 0.0001

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


_SENSOR = (1280, 800)
_MEASURED: dict[str, Any] = {"warp_px": 0.3, "edge_hole_share": 0.15, "flicker_share": 0.25, "patches": 1.0}
"""Errors of real OAK-D cameras: a warp of some tenths of a pixel, 10 to 19 % holes within 8 pixels of a rim, 2 to 9 %
of all pixels flickering, and patches of up to 10 pixels on weak texture."""


def _preset(name: CameraName, noise: StereoNoise | None) -> CameraModel:
    optics = simulated_optics(name, None)
    focal_px = float(optics.K[0, 0])
    return CameraModel(name, focal_px, optics.width, optics.height, optics.near_m, optics.working_m, noise)


CAMERAS = {
    model.name: model
    for model in (
        _preset("ideal-sr", StereoNoise(763.0, 0.020, hole_share=0.03)),
        _preset("ideal", StereoNoise(805.0, 0.075, hole_share=0.02)),
        _preset("ideal-measured", StereoNoise(805.0, 0.075, hole_share=0.02, **_MEASURED)),
        _preset("exact", None),
    )
}
"""Presets of cameras. All but `exact` have the depth of `StereoNoise`.

`ideal` has the figures of an OAK-D Pro: a baseline of 75 mm, extended disparity and every second pixel. `ideal-sr` has
those of an OAK-D SR: 20 mm and all pixels. `ideal-measured` is `ideal` with the errors of real OAK-D cameras.
"""


def camera_model(name: str, resolution: tuple[int, int] | None = None) -> CameraModel:
    """Return a preset, or the same camera with another resolution of its depth image.

    The horizontal field of view stays. Stereo matching uses the sensor's 1280x800 pixels for every resolution, so the
    error in metres does not depend on it.

    Args:
        name: Name of the preset.
        resolution: Width and height of the depth image, or None for those of the preset.

    Raises:
        CameraModelError: The name is unknown, or the sensor does not have the resolution.
    """
    if name not in CAMERAS:
        raise CameraModelError(f"there is no camera model {name!r}; known are {', '.join(CAMERAS)}")
    model = CAMERAS[name]
    if resolution is None:
        return model
    width, height = resolution
    if not (32 <= width <= _SENSOR[0] and 20 <= height <= width * _SENSOR[1] / _SENSOR[0]):
        raise CameraModelError(
            f"{name} has no depth image of {width}x{height}; up to 1280x800, no higher than 10/16 of the width"
        )
    return replace(model, focal_px=model.focal_px * width / model.width, width=width, height=height)


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
    """What a camera sees from one pose."""

    depth: NDArray[np.float32]
    """Exact depth (H, W), metres; infinite without a hit."""
    still: StillImage | None
    """Depth with all errors except those of each exposure, or None for an exact camera."""


class DepthCamera:
    """A camera and a scene. It is built once and captures from many poses."""

    def __init__(self, model: CameraModel, scene: StringScene, bias_px: float = 0.0, device_seed: int = 0) -> None:
        import open3d as o3d

        self.model = model
        self.bias_px = bias_px
        self._warp = None
        if model.noise is not None:
            rng = np.random.default_rng([device_seed, DEVICE_STREAM])
            self._warp = device_warp(model.noise, (model.height, model.width), rng)
        self._caster = o3d.t.geometry.RaycastingScene()
        for vertices, triangles in meshes.scene_meshes(scene):
            self._caster.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(triangles))
        self.strings = len(scene.curves)
        """Number of meshes that are strings, which come first."""
        u, v = np.meshgrid(np.arange(model.width), np.arange(model.height))
        # not of unit length, so that the distance along a ray is the depth along the optical axis
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(model.K).T
        self._rays = rays.astype(np.float32)

    def render(self, T_base_camera: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Return the exact depth (H, W) and the index of the string in each pixel (H, W).

        The depth is along the optical axis, in metres, and infinite without a hit. The index is -1 without a string.

        Args:
            T_base_camera: Camera pose (4, 4) in the scene.
        """
        hits = self._cast(self._rays_from(T_base_camera))
        # the unsigned value for no hit is far beyond the indices of strings
        part = hits["geometry_ids"].astype(np.int64)
        return hits["t_hit"], np.where(part < self.strings, part, -1)

    def surfaces(self, T_base_camera: NDArray[np.float64]) -> Surfaces:
        """Return the surfaces in front of the camera, for an intensity image."""
        rays = self._rays_from(T_base_camera)
        hits = self._cast(rays)
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

    def _cast(self, rays: NDArray[np.float32]) -> dict[str, NDArray[Any]]:
        import open3d as o3d

        hits = self._caster.cast_rays(o3d.core.Tensor.from_numpy(rays))
        return {name: hit.numpy() for name, hit in hits.items()}

    def capture(self, T_base_camera: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint16]:
        """Return the depth image (H, W) of a capture, in depth units; 0 = not measured.

        It is the median of five exposures, computed in one step.

        Args:
            T_base_camera: Camera pose (4, 4) in the scene.
            rng: Generator of the noise.
        """
        return self.expose(self.still_view(T_base_camera, rng), rng, MEDIAN_OF_FIVE)

    def still_view(self, T_base_camera: NDArray[np.float64], rng: np.random.Generator) -> StillView:
        """Return what all exposures from this pose share."""
        depth, string = self.render(T_base_camera)
        if self.model.noise is None:
            return StillView(depth, None)
        still = still_image(depth, self.model.focal_px, self.model.noise, self.bias_px, rng, self._warp)
        return StillView(depth, drop_pixels(still, string >= 0, self.model.noise, rng))

    def expose(self, still_view: StillView, rng: np.random.Generator, frame_share: float = 1.0) -> NDArray[np.uint16]:
        """Return one exposure (H, W), in depth units; 0 = not measured.

        Args:
            still_view: Images that all exposures from the pose share.
            rng: Generator of the noise.
            frame_share: Factor on the error of each frame.
        """
        depth = still_view.depth
        if self.model.noise is not None and still_view.still is not None:
            depth = expose(still_view.still, self.model.noise, rng, frame_share)
        counts = np.rint(np.where(np.isfinite(depth), depth, 0.0) / self.model.depth_unit_m)
        seen = (depth >= self.model.near_m) & (counts <= np.iinfo(np.uint16).max)
        return np.where(seen, counts, 0).astype(np.uint16)
