"""A depth camera that ray-casts a string scene."""

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
    expose,
    still_image,
)
from cell.simulation.scenes.scenes import StringScene

DEVICE_STREAM = 9
"""Stream of a seed from which the errors of one device are drawn."""


class CameraModelError(ValueError):
    """A camera that does not exist, or a resolution that it does not have."""

    slug = "camera-model"


@dataclass(frozen=True)
class CameraModel:
    """What the simulated camera is like."""

    name: str
    focal_px: float
    """Of the depth image."""
    width: int
    height: int
    near_m: float
    """Nearest distance at which it measures."""
    working_m: tuple[float, float]
    """Distances from which strings are well seen."""
    noise: StereoNoise | None
    """None: exact depth, apart from rounding to the unit."""
    depth_unit_m: float = 0.0001

    @property
    def K(self) -> NDArray[np.float64]:
        """(3, 3) pinhole matrix; pixel centres have whole coordinates."""
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
        _preset("oak-d-sr", StereoNoise(763.0, 0.020, hole_share=0.03)),
        _preset("oak-d-pro", StereoNoise(805.0, 0.075, hole_share=0.02)),
        _preset("oak-d-pro-measured", StereoNoise(805.0, 0.075, hole_share=0.02, **_MEASURED)),
        _preset("ideal", None),
    )
}
"""Presets. oak-d-sr: a baseline of 20 mm, all pixels. oak-d-pro: 75 mm, extended disparity, every second pixel."""


def camera_model(name: str, resolution: tuple[int, int] | None = None) -> CameraModel:
    """The preset of that name, or the same camera with another (width, height) of its depth image.

    The field of view across stays; stereo matching runs at the sensor's 1280x800 whatever the depth image's
    size, so that the error in metres does not depend on it.

    Raises:
        CameraModelError: an unknown name, or a resolution that the sensor cannot give.
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
    """What is met by the ray through the middle of each pixel."""

    depth: NDArray[np.float32]
    """(H, W) along the optical axis, metres, infinite where nothing is."""
    part: NDArray[np.int64]
    """(H, W) which of `meshes.scene_meshes`, -1 where nothing is."""
    normals: NDArray[np.float32]
    """(H, W, 3) of the mesh there, scene frame, unit length, to either side; zero where nothing is."""
    points: NDArray[np.float32]
    """(H, W, 3) in the scene frame; the camera's own place where nothing is."""


@dataclass(frozen=True, eq=False)
class Look:
    """What a camera sees from one pose."""

    depth: NDArray[np.float32]
    """(H, W) exact, metres, infinite where nothing is."""
    still: StillImage | None
    """What the camera makes of it, but for the error of each exposure; None for an exact camera."""


class DepthCamera:
    """A camera in front of a scene: built once, it takes pictures from many poses.

    `bias_px` is the disparity bias that the camera has in this session.
    """

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
        """How many of the scene's meshes are strings: the first ones."""
        u, v = np.meshgrid(np.arange(model.width), np.arange(model.height))
        # Not of unit length: the distance along such a ray is the depth along the optical axis.
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(model.K).T
        self._rays = rays.astype(np.float32)

    def render(self, T_base_camera: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """The exact image: depth (H, W) along the optical axis, metres, infinite where nothing is; and which string
        each pixel shows (H, W), -1 where none.
        """
        hits = self._cast(self._rays_from(T_base_camera))
        # Unsigned "nothing hit" is far beyond the strings' numbers.
        part = hits["geometry_ids"].astype(np.int64)
        return hits["t_hit"], np.where(part < self.strings, part, -1)

    def surfaces(self, T_base_camera: NDArray[np.float64]) -> Surfaces:
        """What the camera has before it, as a picture of it needs it."""
        rays = self._rays_from(T_base_camera)
        hits = self._cast(rays)
        depth = hits["t_hit"]
        seen = np.isfinite(depth)
        points = rays[..., :3] + np.where(seen, depth, np.float32(0))[..., None] * rays[..., 3:]
        part = np.where(seen, hits["geometry_ids"].astype(np.int64), -1)
        return Surfaces(depth, part, hits["primitive_normals"], points)

    def _rays_from(self, T_base_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """(H, W, 6) where the rays begin, and where they go."""
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
        """The depth image (H, W) that the camera takes from this pose, in depth units, 0 where it measures nothing.

        It is the median of five exposures, made in one go.
        """
        return self.expose(self.look(T_base_camera, rng), rng, MEDIAN_OF_FIVE)

    def look(self, T_base_camera: NDArray[np.float64], rng: np.random.Generator) -> Look:
        """What all exposures from this pose have in common."""
        depth, _ = self.render(T_base_camera)
        if self.model.noise is None:
            return Look(depth, None)
        return Look(depth, still_image(depth, self.model.focal_px, self.model.noise, self.bias_px, rng, self._warp))

    def expose(self, look: Look, rng: np.random.Generator, frame_share: float = 1.0) -> NDArray[np.uint16]:
        """One exposure (H, W), in depth units, 0 where nothing is measured; the error of each frame is taken times
        `frame_share`.
        """
        depth = look.depth
        if self.model.noise is not None and look.still is not None:
            depth = expose(look.still, self.model.noise, rng, frame_share)
        counts = np.rint(np.where(np.isfinite(depth), depth, 0.0) / self.model.depth_unit_m)
        seen = (depth >= self.model.near_m) & (counts <= np.iinfo(np.uint16).max)
        return np.where(seen, counts, 0).astype(np.uint16)
