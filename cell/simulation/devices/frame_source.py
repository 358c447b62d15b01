"""Render single exposures of the simulated camera on the flange."""

import sys
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.simulation.devices.world import SimulatedWorld
from cell.simulation.rendering.calibration_board import Print
from cell.simulation.rendering.depth_camera import CameraImages, DepthCamera, ImageContent, StillView
from cell.simulation.rendering.image_cache import ImageCache
from cell.simulation.rendering.image_renderer import develop
from cell.simulation.rendering.intensity_image import PictureCamera, lighting
from cell.simulation.rendering.lighting import LIGHT_STREAM
from cell.simulation.rendering.stereo_camera import StillPair

# Numbers of random streams. Streams 0, 1, 3 and 6 of the same seed are in `cell.simulation.devices.world`, and those
# from 7 on except 8 in `cell.simulation.rendering`.
_POSE_STREAM = 4
_EXPOSURE_STREAM = 5
_PICTURE_STREAM = 8


class FrameSource:
    """Render depth and intensity images of a simulated world from given flange poses.

    Images from the same pose differ only by the noise of each exposure. A stereo camera renders its pair of images once
    per pose.
    """

    def __init__(self, world: SimulatedWorld, cache: ImageCache | None = None) -> None:
        """Prepare the scene of the world for ray casting.

        Args:
            world: Table and camera.
            cache: Keeps rendered images between runs; None: they are not kept.
        """
        import_open3d()
        self.world = world
        content = ImageContent(world.rendering, self._print())
        self._camera = DepthCamera(world.camera, world.scene, world.bias_px, world.seed, content, cache)
        self._depth_rng = np.random.default_rng([world.seed, _EXPOSURE_STREAM])
        self._depth_pose = np.zeros((4, 4))
        self._still_view: StillView | StillPair | None = None
        self._dots_on = True
        self._picture_camera: PictureCamera | None = None
        self._picture_pose = np.zeros((4, 4))
        self._noiseless_picture = np.zeros((0, 0), dtype=np.float32)
        self._picture_rng = np.random.default_rng()

    @property
    def is_slow(self) -> bool:
        """Whether the images of a new pose take a considerable time, because they are rendered."""
        return self.world.camera.stereo is not None

    def switch_dots(self, on: bool) -> None:
        """Switch the dot projector on or off, for the images that are rendered from now on."""
        if on != self._dots_on:
            self._dots_on = on
            self._still_view = None
            self._picture_pose = np.zeros((4, 4))

    def render_depth(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Render the depth image of one exposure.

        Args:
            T_base_flange: Reported flange pose (4, 4).

        Returns:
            (H, W) depth along the optical axis, in depth units of the camera. 0 means not measured.
        """
        return self._camera.expose(self._still_at(T_base_flange), self._depth_rng)

    def render_both(self, T_base_flange: NDArray[np.float64]) -> CameraImages:
        """Render the depth image and the intensity image of one exposure.

        A stereo camera gives the left image that the depth was matched in; the others give `render_intensity`.

        Args:
            T_base_flange: Reported flange pose (4, 4).
        """
        images = self._camera.expose_images(self._still_at(T_base_flange), self._depth_rng)
        if images.intensity is not None:
            return images
        return CameraImages(images.depth, self.render_intensity(T_base_flange))

    def render_intensity(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Render an intensity image without depth, with noise of its own.

        The noise depends on the world's seed, the camera's position, and the number of images since the pose changed.

        Args:
            T_base_flange: Reported flange pose (4, 4).

        Returns:
            (H, W) grey levels. Each pixel shows the same surface point as that pixel of the depth image.
        """
        if not np.array_equal(T_base_flange, self._picture_pose):
            self._noiseless_picture = self._still_picture(T_base_flange)
            self._picture_rng = self._rng_at(self.world.T_scene_camera(T_base_flange), _PICTURE_STREAM)
            self._picture_pose = T_base_flange.copy()
        return develop(self._noiseless_picture, self._picture_rng)

    def _still_at(self, T_base_flange: NDArray[np.float64]) -> StillView | StillPair:
        """Return what all exposures from a pose share. That of the last pose is kept."""
        if self._still_view is None or not np.array_equal(T_base_flange, self._depth_pose):
            T_scene_camera = self.world.T_scene_camera(T_base_flange)
            rng = self._rng_at(T_scene_camera, _POSE_STREAM)
            self._still_view = self._camera.still_view(T_scene_camera, rng, self._dots_on)
            self._depth_pose = T_base_flange.copy()
        return self._still_view

    def _still_picture(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return what all intensity images from a pose share, in grey levels (H, W)."""
        if self.world.camera.stereo is not None:
            still = self._still_at(T_base_flange)
            assert isinstance(still, StillPair)
            return still.left
        if self._picture_camera is None:
            light = lighting(np.random.default_rng([self.world.seed, LIGHT_STREAM]))
            self._picture_camera = PictureCamera(self._camera, light, self._print())
        return self._picture_camera.still(self.world.T_scene_camera(T_base_flange))

    def _print(self) -> Print | None:
        """Return the print of the calibration board in the scene, or None without a board."""
        board, T_base_board = self.world.board, self.world.T_base_board
        if board is None or T_base_board is None:
            return None
        return Print(board, inverse(self.world.T_base_scene) @ T_base_board)

    def _rng_at(self, T_scene_camera: NDArray[np.float64], stream: int) -> np.random.Generator:
        """Return a random generator whose seed is the world's seed, the camera's position and the stream."""
        position = np.rint(T_scene_camera[:3, 3] * 1e5).astype(np.int64) + 2**40
        return np.random.default_rng([self.world.seed, stream, *map(int, position)])


def import_open3d() -> None:
    """Import open3d without its plotly module, which takes three quarters of the import time."""
    plots = ModuleType("open3d.visualization.draw_plotly")
    plots.__getattr__ = lambda name: None  # `open3d.visualization` imports names from this module.
    sys.modules.setdefault(plots.__name__, plots)
    import open3d  # noqa: F401 (later imports of open3d reuse this module)
