"""Single exposures of a simulated camera on the flange."""

import sys
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.simulation.devices.world import SimulatedWorld
from cell.simulation.rendering.calibration_board import Print
from cell.simulation.rendering.depth_camera import DepthCamera, Look
from cell.simulation.rendering.intensity_image import PictureCamera, developed, lighting

# streams of the world's seed; `cell.simulation.devices.world` uses 0 to 3 and 6
_LOOK, _EXPOSURE, _LIGHT, _PICTURE = 4, 5, 7, 8


class FrameSource:
    """Depth and intensity images from the flange poses of an arm.

    Images from one pose differ only by the noise of each frame.
    """

    def __init__(self, world: SimulatedWorld) -> None:
        """Build the scene for ray casting."""
        _import_open3d()
        self.world = world
        self._camera = DepthCamera(world.camera, world.scene, world.bias_px, world.seed)
        self._rng = np.random.default_rng([world.seed, _EXPOSURE])
        self._T_base_flange = np.zeros((4, 4))
        self._look: Look | None = None
        self._pictures: PictureCamera | None = None
        self._pictured_from = np.zeros((4, 4))
        self._still = np.zeros((0, 0), dtype=np.float32)
        self._noise = np.random.default_rng()

    def expose(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Return one depth image (H, W) at a reported flange pose (4, 4), in depth units; 0 = not measured."""
        if self._look is None or not np.array_equal(T_base_flange, self._T_base_flange):
            T_scene_camera = self.world.T_scene_camera(T_base_flange)
            self._look = self._camera.look(T_scene_camera, self._of_place(T_scene_camera, _LOOK))
            self._T_base_flange = T_base_flange.copy()
        return self._camera.expose(self._look, self._rng)

    def picture(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return one intensity image (H, W), grey levels, which matches the depth image pixel for pixel.

        A pose that is visited again gives the same images in the same order.

        Args:
            T_base_flange: Reported flange pose (4, 4).
        """
        if self._pictures is None:
            light = lighting(np.random.default_rng([self.world.seed, _LIGHT]))
            self._pictures = PictureCamera(self._camera, light, self._print())
        if not np.array_equal(T_base_flange, self._pictured_from):
            T_scene_camera = self.world.T_scene_camera(T_base_flange)
            self._still = self._pictures.still(T_scene_camera)
            self._noise = self._of_place(T_scene_camera, _PICTURE)
            self._pictured_from = T_base_flange.copy()
        return developed(self._still, self._noise)

    def _print(self) -> Print | None:
        board, T_base_board = self.world.board, self.world.T_base_board
        if board is None or T_base_board is None:
            return None
        return Print(board, inverse(self.world.T_base_scene) @ T_base_board)

    def _of_place(self, T_scene_camera: NDArray[np.float64], stream: int) -> np.random.Generator:
        """Return a generator that depends only on the pose, for what all frames from a pose share."""
        place = np.rint(T_scene_camera[:3, 3] * 1e5).astype(np.int64) + 2**40
        return np.random.default_rng([self.world.seed, stream, *map(int, place)])


def _import_open3d() -> None:
    """Import open3d without its plots for web pages, which take three quarters of the time to import."""
    plots = ModuleType("open3d.visualization.draw_plotly")
    plots.__getattr__ = lambda name: None  # open3d re-exports names of this module
    sys.modules.setdefault(plots.__name__, plots)
    import open3d  # noqa: F401 (whoever imports it later gets this one)
