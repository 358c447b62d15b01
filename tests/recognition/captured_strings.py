"""Depth images of strings along given curves, for tests of lines of sight."""

from dataclasses import dataclass

import numpy as np

from cell.planning.look_at import look_at
from cell.simulation.rendering.depth_camera import DepthCamera, camera_model
from cell.simulation.scenes.clutter import Box
from cell.simulation.scenes.scenes import StringScene
from recognition.preprocessing.normals import NormalCloud

R = 0.0042


@dataclass(frozen=True, eq=False)
class Image:
    """A depth image, as recognition reads it."""

    depth: np.ndarray
    depth_unit_m: float
    K: np.ndarray
    T_base_camera: np.ndarray
    index: int


def captured(*curves: np.ndarray, boxes: tuple[Box, ...] = (), tilt_deg: float = 50) -> list[NormalCloud]:
    """Return six views with the noise of a stereo camera at 0.5 m."""
    camera = DepthCamera(camera_model("ideal"), StringScene("hand-made", R, curves, boxes))
    clouds = []
    for k in range(6):
        T = look_at(np.zeros(3), np.radians(60 * k), np.radians(tilt_deg), 0.5, 0.0)
        depth = camera.capture(T, np.random.default_rng(k))
        image = Image(depth, camera.model.depth_unit_m, camera.model.K, T, k)
        clouds.append(NormalCloud(k, np.empty((0, 3)), np.empty((0, 3)), np.eye(4), T, image))
    return clouds


def along_x(start: float, end: float) -> np.ndarray:
    x = np.linspace(start, end, round((end - start) / 0.001) + 1)
    return np.column_stack([x, np.zeros_like(x), np.full_like(x, R)])
