"""The devices of a cell. This is the only place that knows their kinds and makes them.

A new kind of camera or arm is one entry of `CAMERA_KINDS` or `ARM_KINDS`; docs/contributor/adding-a-device.md has the
steps.
"""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.storage.hand_eye_file import HandEye
from calibration.target.board import Board
from cell.arm.ur_arm import UrArm
from cell.camera.camera import LiveCamera, MakeDriver
from cell.camera.oak_device import open_device
from cell.camera.oak_driver import OakDriver
from cell.camera_profile.depth_profile import DepthProfile
from cell.camera_profile.measure import SeenTable
from cell.config.arm_config import ArmSettings, SimulatedArm, URArm
from cell.config.camera_config import CameraSettings, OakCamera, SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.devices import ArmState, DrivenArm
from cell.errors import RobotUnreachableError, ViewpointsError
from cell.planning.home import home_posture
from cell.simulation.devices.flange_pose import controller_pose, reported_pose
from cell.simulation.devices.oak_pipeline import open_simulated
from cell.simulation.devices.world import SimulatedWorld, simulated_world
from cell.simulation.profiling.expected_profile import expected_profiles, model_of_oak
from cell.simulation.rendering.depth_camera import CameraModel
from cell.simulation.ur_controller.launcher import ControllerStartError, RunningController, start_controller

log = logging.getLogger(__name__)


class Equipment:
    """Arm and camera of one cell, and for a simulated cell its controller process and its world.

    It belongs to one thread at a time. Only `stop`, `cancel_connecting`, `world`, `latest_arm_state` and
    `controller_address` may be used from any thread.
    """

    def __init__(self, settings: CellSettings) -> None:
        """Make no device yet: the first use of `arm` and `camera` does."""
        self.settings = settings
        self.controller: RunningController | None = None
        """Controller process of a simulated arm, once it was started."""
        self._world: SimulatedWorld | None = None
        self._making_world = threading.Lock()
        self._arm: DrivenArm | None = None
        self._camera: LiveCamera | None = None
        self._cancelled = threading.Event()

    @property
    def world(self) -> SimulatedWorld | None:
        """World of a simulated camera, or None for a real one."""
        with self._making_world:
            if self._world is None and isinstance(self.settings.camera, SimulatedCamera):
                self._world = simulated_world(self.settings)
            return self._world

    @property
    def nominal_hand_eye(self) -> HandEye | None:
        """Calibration that a simulated cell has without a file, or None for a real cell."""
        return None if self.world is None else self.world.nominal_hand_eye

    @property
    def arm(self) -> DrivenArm:
        """The arm, which may not be connected."""
        kind = ARM_KINDS[type(self.settings.arm)]
        address = kind.address(self.settings.arm, self)
        if self._arm is None or self._arm.host != address:
            if self._arm is not None:
                self._arm.close()
            self._arm = kind.make(self.settings.arm, address)
        return self._arm

    @property
    def camera(self) -> LiveCamera:
        """The camera, which may not be connected."""
        if self._camera is None:
            settings, kind = self.settings.camera, CAMERA_KINDS[type(self.settings.camera)]
            self._camera = LiveCamera(settings, partial(kind.prepare_driver, settings, self), kind.open_timeout_s)
        if self._cancelled.is_set():
            self._camera.cancel_connecting()
        return self._camera

    def expected_profiles(self, seen: SeenTable) -> list[DepthProfile]:
        """Return the profiles of a simulated camera of the kind of this cell's camera, on textured tables.

        Args:
            seen: Table in front of the camera.

        Returns:
            The profiles. There are none if no simulated camera is of this kind, or if it sees no table from there.
        """
        kind = CAMERA_KINDS[type(self.settings.camera)]
        if kind.model is None:
            return []
        return expected_profiles(kind.model(self.settings.camera, self, seen), seen)

    def lay_board(self, board: Board | None) -> None:
        """Put a calibration board on the table of a simulated cell, or the strings again. None means the strings.

        At a real cell a person does that. A camera that was connected to the other world is closed.
        """
        if self.world is None or self.world.board == board:
            return
        if self._camera is not None:
            self._camera.close()
            self._camera = None
        with self._making_world:
            strings = simulated_world(self.settings)
            self._world = strings if board is None else strings.with_board(board)

    @property
    def latest_arm_state(self) -> ArmState | None:
        """Last state that the arm reported, or None. Nothing is queried."""
        arm = self._arm
        return None if arm is None else arm.latest

    @property
    def controller_address(self) -> str | None:
        """Address of the arm's controller, or None before a simulated one was started."""
        return None if self._arm is None else self._arm.host

    def stop(self) -> None:
        """Stop the arm, if there is one."""
        arm = self._arm
        if arm is not None:
            arm.stop()

    def cancel_connecting(self) -> None:
        """Let the current and every later connection of the camera fail at once. To be called before `close`."""
        self._cancelled.set()  # first: a camera that is being made reads it afterwards
        camera = self._camera
        if camera is not None:
            camera.cancel_connecting()

    def release_arm(self) -> None:
        """End the connection to the arm, and with it the program on the robot."""
        if self._arm is not None:
            self._arm.close()

    def close(self) -> None:
        """Release all devices, the arm first, and end a simulated controller."""
        for device in (self._arm, self._camera, self.controller):
            if device is not None:
                device.close()
        self._camera = self._arm = self.controller = None

    def simulated_controller(self, arm: SimulatedArm) -> str:
        """Return the address of the simulated controller. It is started if it does not run.

        Raises:
            RobotUnreachableError: The controller process cannot be started.
        """
        if self.controller is None or not self.controller.alive:
            if self.controller is not None:
                self.controller.close()
            try:
                self.controller = start_controller(
                    *(arm.model, arm.host, arm.time_factor, self._first_posture()),
                    pose_error=(arm.pose_error_m, arm.pose_error_rad),
                    seed=arm.pose_error_seed,
                )
            except ControllerStartError as error:
                raise RobotUnreachableError(str(error)) from error
            log.info("the simulated arm's controller listens at %s", self.controller.host)
        return self.controller.host

    def _first_posture(self) -> NDArray[np.float64] | None:
        """Return the first joint angles (6,) of a simulated arm, or None for its default."""
        if self.world is None:
            return None
        try:
            return home_posture(self.settings, self.world.nominal_T_flange_camera)
        except ViewpointsError:
            return None  # a scan will report it


@dataclass(frozen=True)
class ArmKind:
    """A kind of arm."""

    address: Callable[[Any, Equipment], str]
    """Returns the address of the controller, from the arm's settings and the equipment."""
    make: Callable[[Any, str], DrivenArm]
    """Makes the arm from its settings and the address. No connection is made yet."""


@dataclass(frozen=True)
class CameraKind:
    """A kind of camera."""

    prepare_driver: Callable[[Any, Equipment], MakeDriver]
    """Returns what makes the driver, from the camera's settings and the equipment. It is called at each connection."""
    open_timeout_s: float
    """Timeout of the driver's start and of opening the camera."""
    model: Callable[[Any, Equipment, SeenTable], CameraModel] | None = None
    """Returns the simulated camera of the same kind, from the camera's settings, the equipment and its images. None
    means that there is no such camera, so that the self-test does not compare the depth."""


def _model_of_world(camera: SimulatedCamera, equipment: Equipment, _: SeenTable) -> CameraModel:
    assert equipment.world is not None  # the camera is a simulated one
    return equipment.world.camera


def _simulated_oak(camera: SimulatedCamera, equipment: Equipment) -> MakeDriver:
    arm, world = equipment.settings.arm, equipment.world
    assert world is not None  # the camera is a simulated one
    pose_of = controller_pose if isinstance(arm, SimulatedArm) else partial(reported_pose, arm.model)
    make_pose = partial(pose_of, ARM_KINDS[type(arm)].address(arm, equipment))
    return partial(OakDriver, camera, partial(open_simulated, camera, world, make_pose))


ARM_KINDS: dict[type[ArmSettings], ArmKind] = {
    URArm: ArmKind(lambda arm, _: arm.host, UrArm),
    SimulatedArm: ArmKind(lambda arm, equipment: equipment.simulated_controller(arm), UrArm),
}
"""Every kind of arm, by the class of its settings."""
CAMERA_KINDS: dict[type[CameraSettings], CameraKind] = {
    # a camera in a network takes up to half of its timeout to start
    OakCamera: CameraKind(
        lambda camera, _: partial(OakDriver, camera, partial(open_device, camera)),
        30.0,
        lambda camera, _, seen: model_of_oak(camera, seen),
    ),
    # a busy machine takes long to load and build the simulated world
    SimulatedCamera: CameraKind(_simulated_oak, 60.0, _model_of_world),
}
"""Every kind of camera, by the class of its settings."""
