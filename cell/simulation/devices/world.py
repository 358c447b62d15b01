"""Hold the true state of a simulated cell, and the errors of its reported poses.

The true state is the pose of the strings or of a calibration board on the table, and the mounting of the camera. The
camera sees a square table around the workspace. It does not see the links of the arm.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.transforms import inverse, transform_points
from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.config.camera_config import SimulatedCamera, simulated_camera_id
from cell.config.cell_config import CellSettings
from cell.config.rendering_options import RenderingOptions
from cell.errors import CellSettingsError
from cell.simulation.pose_errors import T_FLANGE_CAMERA, PoseErrors, perturbed
from cell.simulation.rendering.calibration_board import lay_board, plate
from cell.simulation.rendering.depth_camera import (
    CameraModel,
    camera_model,
    camera_of_preset,
    draw_bias_px,
    image_provenance,
)
from cell.simulation.scenes.ground_truth import scene_truth
from cell.simulation.scenes.scenes import StringScene, make_scene

# Numbers of random streams. `cell.simulation.offline_scan` uses the first two for the same bias and calibration.
_SESSION, _POSES, _ROBOT, _BOARD = 0, 1, 3, 6

_POSE_ROUNDING = 1e-5
"""Rounding step of the entries of a flange pose (translation in metres). The rounded entries seed the pose error."""


@dataclass(frozen=True, eq=False)
class SimulatedWorld:
    """A table with strings, and a camera on the flange of an arm above it."""

    scene: StringScene
    """Strings and other objects on the table, scene frame."""
    T_base_scene: NDArray[np.float64]
    """(4, 4) pose of the scene. Its origin is on the table in the middle of the workspace."""
    camera: CameraModel
    """Geometry and noise of the camera."""
    bias_px: float
    """Constant error of all disparities in this session, pixels."""
    T_flange_camera: NDArray[np.float64]
    """(4, 4) true mounting of the camera."""
    nominal_T_flange_camera: NDArray[np.float64]
    """(4, 4) mounting of the camera by the nominal hand-eye calibration, which has an error."""
    errors: PoseErrors
    """Root mean square errors of the reported flange poses and of the hand-eye calibration."""
    seed: int
    """Seed of the pose errors, the noise, the light and the pose of the board. `scene` is already drawn."""
    rendering: RenderingOptions = field(default_factory=RenderingOptions)
    """Options of the rendered images."""
    board: Board | None = None
    """Calibration board on the table, or None for strings."""
    T_base_board: NDArray[np.float64] | None = None
    """(4, 4) true pose of the board, or None without a board. Its z axis points into the table."""

    @property
    def camera_id(self) -> str:
        """Device id of the simulated camera."""
        return simulated_camera_id(self.camera.name, self.seed)

    @property
    def provenance(self) -> dict[str, str]:
        """What the images show, for a recording. It is empty for a camera without rendered images."""
        return image_provenance(self.camera, self.rendering, self.seed)

    @property
    def nominal_hand_eye(self) -> HandEye:
        """Nominal hand-eye calibration, in the form in which a real cell reads it from a file."""
        return HandEye(
            T_flange_camera=self.nominal_T_flange_camera,
            created=None,
            camera_id=self.camera_id,
            robot_serial=None,
            sha256=hashlib.sha256(self.nominal_T_flange_camera.tobytes()).hexdigest(),
        )

    def with_board(self, board: Board) -> "SimulatedWorld":
        """Return the same cell with a calibration board instead of the strings.

        The board lies flat near the middle of the workspace. The same board and seed give the same pose.
        """
        T_scene_board = lay_board(board, np.random.default_rng([self.seed, _BOARD]))
        scene = StringScene("board", self.scene.radius_m, (), (plate(board, T_scene_board),))
        return replace(self, scene=scene, board=board, T_base_board=self.T_base_scene @ T_scene_board)

    def T_base_camera(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the true camera pose (4, 4) for a reported flange pose (4, 4).

        The error of the flange pose is random, and always the same for the same pose.
        """
        rounded = np.rint(T_base_flange[:3] / _POSE_ROUNDING).astype(np.int64).ravel() + 2**40
        rng = np.random.default_rng([self.seed, _ROBOT, *map(int, rounded)])
        return perturbed(T_base_flange, self.errors.robot_m, self.errors.robot_rad, rng) @ self.T_flange_camera

    def T_scene_camera(self, T_base_flange: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the true camera pose (4, 4) in the scene for a reported flange pose (4, 4)."""
        return inverse(self.T_base_scene) @ self.T_base_camera(T_base_flange)


def simulated_world(settings: CellSettings) -> SimulatedWorld:
    """Draw the world of a cell with a simulated camera. The same settings give the same world.

    Args:
        settings: Settings of the cell. The camera and the workspace are used.

    Returns:
        The world, with strings on the table.

    Raises:
        CellSettingsError: The camera is a real camera, or the scene cannot be made.
    """
    camera = settings.camera
    if not isinstance(camera, SimulatedCamera):
        raise CellSettingsError(
            f'camera.kind is {camera.kind}: a simulated world needs a simulated camera: set camera.kind to "simulated"'
        )
    try:
        scene = make_scene(camera.scene, camera.seed, radius_m=camera.string_radius_m)
    except ValueError as error:
        raise CellSettingsError(f"camera.scene: {error}") from error
    errors = PoseErrors().scaled(camera.errors)
    model = camera_model(camera.model) if camera.preset is None else camera_of_preset(camera.preset)
    T_base_scene = np.eye(4)
    (x0, x1), (y0, y1), (table_z, _) = settings.workspace_m
    T_base_scene[:3, 3] = (x0 + x1) / 2, (y0 + y1) / 2, table_z
    return SimulatedWorld(
        scene=scene,
        T_base_scene=T_base_scene,
        camera=model,
        bias_px=draw_bias_px(model, np.random.default_rng([camera.seed, _SESSION])),
        T_flange_camera=T_FLANGE_CAMERA,
        nominal_T_flange_camera=perturbed(
            T_FLANGE_CAMERA, errors.hand_eye_m, errors.hand_eye_rad, np.random.default_rng([camera.seed, _POSES])
        ),
        errors=errors,
        seed=camera.seed,
        rendering=camera.rendering,
    )


def world_truth(world: SimulatedWorld, reported_T_base_flange: Sequence[NDArray[np.float64]] = ()) -> dict[str, Any]:
    """Return the truth document of a simulated cell, in the base frame.

    Args:
        world: World of the simulated cell.
        reported_T_base_flange: Reported flange pose (4, 4) of each view. The document has the true camera poses of
            these views.

    Returns:
        Document as from `cell.simulation.scenes.ground_truth.scene_truth`.
    """
    truth = scene_truth(world.scene, [world.T_base_camera(T) for T in reported_T_base_flange], world.T_flange_camera)

    def moved(points: list[list[float]]) -> list[list[float]]:
        return transform_points(world.T_base_scene, np.array(points).reshape(-1, 3)).round(7).tolist()

    truth["curves"] = [moved(curve) for curve in truth["curves"]]
    for crossing in truth["crossings"]:
        crossing["point"] = moved([crossing["point"]])[0]
    return truth
