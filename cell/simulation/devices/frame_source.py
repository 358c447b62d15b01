"""The single exposures of a simulated camera that an arm carries through its world."""

import sys
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse
from cell.simulation.devices.world import SimulatedWorld
from cell.simulation.rendering.calibration_board import Print
from cell.simulation.rendering.depth_camera import DepthCamera, Look
from cell.simulation.rendering.intensity_image import PictureCamera, developed, lighting

# Streams of the world's seed; 0 to 3 and 6 are others' (see `cell.simulation.devices.world`).
_LOOK, _EXPOSURE, _LIGHT, _PICTURE = 4, 5, 7, 8


class FrameSource:
    """Depth images and pictures from where the flange is. Those from one pose share all but the noise of each."""

    def __init__(self, world: SimulatedWorld) -> None:
        """Builds what the rays are cast at."""
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
        """One exposure (H, W) at the flange pose (4, 4) that the robot tells; depth units, 0 = not measured."""
        if self._look is None or not np.array_equal(T_base_flange, self._T_base_flange):
            T_scene_camera = self.world.T_scene_camera(T_base_flange)
            self._look = self._camera.look(T_scene_camera, self._of_place(T_scene_camera, _LOOK))
            self._T_base_flange = T_base_flange.copy()
        return self._camera.expose(self._look, self._rng)

    def picture(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.uint8]:
        """One picture (H, W), grey levels, at the flange pose (4, 4) that the robot tells: pixel for pixel what the
        depth image is of. Whoever comes back to a pose gets the same pictures, one after the other.
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
        """What stays in all frames from a pose is drawn from the pose: coming back to it shows the same."""
        place = np.rint(T_scene_camera[:3, 3] * 1e5).astype(np.int64) + 2**40
        return np.random.default_rng([self.world.seed, stream, *map(int, place)])


def _import_open3d() -> None:
    """Imports open3d without its plots for web pages: they would take three quarters of the time, seconds that a
    camera which is connected anew in the middle of a scan can do without."""
    plots = ModuleType("open3d.visualization.draw_plotly")
    plots.__getattr__ = lambda name: None  # whatever open3d wants to hand on of them
    sys.modules.setdefault(plots.__name__, plots)
    import open3d  # noqa: F401 (whoever imports it later gets this one)
