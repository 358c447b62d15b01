"""The single exposures of a simulated camera that an arm carries through its world."""

import sys
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from cell.simulation.camera import DepthCamera, Look
from cell.simulation.world import SimulatedWorld

# Streams of the world's seed; 0 to 3 are others' (see `cell.simulation.world`).
_LOOK, _EXPOSURE = 4, 5


class FrameSource:
    """Depth images from where the flange is. Exposures from one pose share all but the noise of each frame."""

    def __init__(self, world: SimulatedWorld) -> None:
        """Builds what the rays are cast at."""
        _import_open3d()
        self.world = world
        self._camera = DepthCamera(world.camera, world.scene, world.bias_px)
        self._rng = np.random.default_rng([world.seed, _EXPOSURE])
        self._T_base_flange = np.zeros((4, 4))
        self._look: Look | None = None

    def expose(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.uint16]:
        """One exposure (H, W) at the flange pose (4, 4) that the robot tells; depth units, 0 = not measured."""
        if self._look is None or not np.array_equal(T_base_flange, self._T_base_flange):
            T_scene_camera = self.world.T_scene_camera(T_base_flange)
            # What stays in all frames from a pose is drawn from the pose: coming back to it shows the same.
            place = np.rint(T_scene_camera[:3, 3] * 1e5).astype(np.int64) + 2**40
            rng = np.random.default_rng([self.world.seed, _LOOK, *map(int, place)])
            self._look = self._camera.look(T_scene_camera, rng)
            self._T_base_flange = T_base_flange.copy()
        return self._camera.expose(self._look, self._rng)


def _import_open3d() -> None:
    """Imports open3d without its plots for web pages: they would take three quarters of the time, seconds that a
    camera which is connected anew in the middle of a scan can do without."""
    plots = ModuleType("open3d.visualization.draw_plotly")
    plots.__getattr__ = lambda name: None  # whatever open3d wants to hand on of them
    sys.modules.setdefault(plots.__name__, plots)
    import open3d  # noqa: F401 (whoever imports it later gets this one)
