"""What a simulated cell is like in truth: where the strings or a calibration board lie, how the camera is mounted, and
how far what is told of it is off.

The arm's own links are not in the picture, and the table is a square about the workspace.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.config.camera_config import SimulatedCamera, simulated_camera_id
from cell.config.cell_config import CellSettings
from cell.errors import CellSettingsError
from cell.simulation.pose_errors import T_FLANGE_CAMERA, PoseErrors, perturbed
from cell.simulation.rendering.calibration_board import lay_board, plate
from cell.simulation.rendering.depth_camera import CameraModel, camera_model
from cell.simulation.scenes.ground_truth import scene_truth
from cell.simulation.scenes.scenes import StringScene, make_scene

# Streams of one seed, the first two as in `cell.simulation.offline_scan`: the same seed has the same bias and
# calibration.
_SESSION, _POSES, _ROBOT, _BOARD = 0, 1, 3, 6

_ALIKE = 1e-5
"""Flange poses that differ by less, metres and radians, have the same error."""


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """A table with strings, and a camera on an arm's flange above it."""

    scene: StringScene
    T_base_scene: NDArray[np.float64]
    """The scene's origin on the table, in the middle of the workspace."""
    camera: CameraModel
    bias_px: float
    """Of the camera's disparities, in this session."""
    T_flange_camera: NDArray[np.float64]
    """How the camera is mounted in truth."""
    told_T_flange_camera: NDArray[np.float64]
    """What the hand-eye calibration says of it."""
    errors: PoseErrors
    """Of what arm and calibration tell."""
    seed: int
    """Of everything random but the scene."""
    board: Board | None = None
    """A calibration board that lies on the table instead of strings."""
    T_base_board: NDArray[np.float64] | None = None
    """Where it lies in truth: the board's frame, whose z points into the paper and so into the table."""

    @property
    def camera_id(self) -> str:
        """The simulated camera's device id."""
        return simulated_camera_id(self.camera.name, self.seed)

    @property
    def told_hand_eye(self) -> HandEye:
        """What a calibration file would tell of the camera's mounting."""
        return HandEye(
            T_flange_camera=self.told_T_flange_camera,
            created=None,
            camera_id=self.camera_id,
            robot_serial=None,
            sha256=hashlib.sha256(self.told_T_flange_camera.tobytes()).hexdigest(),
        )

    def with_board(self, board: Board) -> "SimulatedWorld":
        """The same cell with nothing on its table but the board, near the workspace's middle; the same seed lays it to
        the same place.
        """
        T_scene_board = lay_board(board, np.random.default_rng([self.seed, _BOARD]))
        scene = StringScene("board", self.scene.radius_m, (), (plate(board, T_scene_board),))
        return replace(self, scene=scene, board=board, T_base_board=self.T_base_scene @ T_scene_board)

    def T_base_camera(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where the camera really is when the robot tells this flange pose: the same for the same pose."""
        told = np.rint(T_base_flange[:3] / _ALIKE).astype(np.int64).ravel() + 2**40
        rng = np.random.default_rng([self.seed, _ROBOT, *map(int, told)])
        return perturbed(T_base_flange, self.errors.robot_m, self.errors.robot_rad, rng) @ self.T_flange_camera

    def T_scene_camera(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
        """The same, seen from the scene."""
        return inverse(self.T_base_scene) @ self.T_base_camera(T_base_flange)


def simulated_world(settings: CellSettings) -> SimulatedWorld:
    """The world of a cell with a simulated camera; the same settings give the same world.

    Raises:
        CellSettingsError: the camera is a real one, or there is no such scene.
    """
    camera = settings.camera
    if not isinstance(camera, SimulatedCamera):
        raise CellSettingsError(f"camera.kind is {camera.kind}: only a simulated camera looks at a simulated world")
    try:
        scene = make_scene(camera.scene, camera.seed, radius_m=camera.string_radius_m)
    except ValueError as error:
        raise CellSettingsError(f"camera.scene: {error}") from error
    errors = PoseErrors().scaled(camera.errors)
    model = camera_model(camera.model)
    bias_px = 0.0
    if model.noise is not None:
        bias_px = model.noise.bias_px * np.random.default_rng([camera.seed, _SESSION]).standard_normal()
    T_base_scene = np.eye(4)
    (x0, x1), (y0, y1), (table_z, _) = settings.workspace_m
    T_base_scene[:3, 3] = (x0 + x1) / 2, (y0 + y1) / 2, table_z
    return SimulatedWorld(
        scene=scene,
        T_base_scene=T_base_scene,
        camera=model,
        bias_px=float(bias_px),
        T_flange_camera=T_FLANGE_CAMERA,
        told_T_flange_camera=perturbed(
            T_FLANGE_CAMERA, errors.hand_eye_m, errors.hand_eye_rad, np.random.default_rng([camera.seed, _POSES])
        ),
        errors=errors,
        seed=camera.seed,
    )


def world_truth(world: SimulatedWorld, told_T_base_flange: Sequence[NDArray[np.float64]] = ()) -> dict[str, Any]:
    """The truth as JSON, as of `cell.simulation.scenes.ground_truth.scene_truth`, in the robot's base frame.

    `told_T_base_flange` are the flange poses of the views, for the true camera poses among it.
    """
    truth = scene_truth(world.scene, [world.T_base_camera(T) for T in told_T_base_flange], world.T_flange_camera)

    def moved(points: list[list[float]]) -> list[list[float]]:
        return transform_points(world.T_base_scene, np.array(points).reshape(-1, 3)).round(7).tolist()

    truth["curves"] = [moved(curve) for curve in truth["curves"]]
    for crossing in truth["crossings"]:
        crossing["point"] = moved([crossing["point"]])[0]
    return truth
