"""The devices that the settings name: made here, and only here."""

import logging
import threading
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calibration.target.board import Board
from cell.arm.ur_arm import UrArm
from cell.camera.camera import LiveCamera
from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import SimulatedCamera
from cell.config.cell_config import CellSettings
from cell.devices import ArmState
from cell.errors import RobotUnreachableError, ViewpointsError
from cell.planning.viewpoints import home_posture
from cell.simulation.devices.flange_pose import controller_pose, reported_pose
from cell.simulation.devices.world import SimulatedWorld, simulated_world
from cell.simulation.ur_controller.launcher import ControllerStartError, RunningController, start_controller

log = logging.getLogger(__name__)


class Equipment:
    """Arm and camera of one cell; for a simulated one also the controller's process and the world it stands in.

    Belongs to one thread at a time, but for `stop`, `give_up_connecting`, `world`, `latest_arm_state` and
    `controller_address`.
    """

    def __init__(self, settings: CellSettings) -> None:
        """Makes nothing yet: the first use of `arm` and `camera` does."""
        self.settings = settings
        self.controller: RunningController | None = None
        """Of a simulated arm, once it is made."""
        self._world: SimulatedWorld | None = None
        self._making = threading.Lock()
        """Of the world, which takes a moment to make."""
        self._arm: UrArm | None = None
        self._camera: LiveCamera | None = None
        self._given_up = threading.Event()

    @property
    def world(self) -> SimulatedWorld | None:
        """What a simulated camera sees; None without one."""
        with self._making:
            if self._world is None and isinstance(self.settings.camera, SimulatedCamera):
                self._world = simulated_world(self.settings)
            return self._world

    @property
    def arm(self) -> UrArm:
        """The arm; it may not be connected."""
        host = self._controller_host()
        if self._arm is None or self._arm.host != host:
            if self._arm is not None:
                self._arm.close()
            self._arm = UrArm(self.settings.arm, host)
        return self._arm

    @property
    def camera(self) -> LiveCamera:
        """The camera; it may not be connected."""
        if self._camera is None:
            arm = self.settings.arm
            pose_of = controller_pose if isinstance(arm, SimulatedArm) else partial(reported_pose, arm.model)
            self._camera = LiveCamera(self.settings.camera, self.world, self._controller_host, pose_of)
        if self._given_up.is_set():
            self._camera.give_up_connecting()
        return self._camera

    def lay_board(self, board: Board | None) -> None:
        """Lays a calibration board on a simulated cell's table, or the strings again; a real one is a person's work.

        A camera that saw something else is closed: it must be connected anew.
        """
        if self.world is None or self.world.board == board:
            return
        if self._camera is not None:
            self._camera.close()
            self._camera = None
        with self._making:
            strings = simulated_world(self.settings)
            self._world = strings if board is None else strings.with_board(board)

    @property
    def latest_arm_state(self) -> ArmState | None:
        """What the arm last told of itself, while it moved or was asked; asks nothing."""
        arm = self._arm
        return None if arm is None else arm.latest

    @property
    def controller_address(self) -> str | None:
        """Where the arm's controller listens; None before a simulated one was started."""
        return None if self._arm is None else self._arm.host

    def stop(self) -> None:
        """Stops the arm, from any thread, if there is one."""
        arm = self._arm
        if arm is not None:
            arm.stop()

    def give_up_connecting(self) -> None:
        """From any thread, before `close`, for good: no camera is waited for any more that is not connected yet."""
        self._given_up.set()  # first: a camera that is only just being made is told then
        camera = self._camera
        if camera is not None:
            camera.give_up_connecting()

    def release_arm(self) -> None:
        """Ends the arm's connection, and with it our program on the robot."""
        if self._arm is not None:
            self._arm.close()

    def close(self) -> None:
        """Lets everything go, the arm first; a simulated controller ends."""
        for device in (self._arm, self._camera, self.controller):
            if device is not None:
                device.close()
        self._camera = self._arm = self.controller = None

    def _controller_host(self) -> str:
        """Where the controller listens; a simulated one is started, or started again when it has died."""
        match self.settings.arm:
            case URArm(host=host):
                return host
            case SimulatedArm(model=model, host=host, time_factor=time_factor):
                if self.controller is None or not self.controller.alive:
                    if self.controller is not None:
                        self.controller.close()
                    try:
                        self.controller = start_controller(model, host, time_factor, self._home())
                    except ControllerStartError as error:
                        raise RobotUnreachableError(str(error)) from error
                    log.info("the simulated arm's controller listens at %s", self.controller.host)
                return self.controller.host

    def _home(self) -> NDArray[np.float64] | None:
        """Where a simulated arm stands at first; None, its usual place, where the scene has no room for a home."""
        if self.world is None:
            return None
        try:
            return home_posture(self.settings, self.world.told_T_flange_camera)
        except ViewpointsError:
            return None  # told when a scan is planned
