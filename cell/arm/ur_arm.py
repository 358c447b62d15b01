"""A UR arm, real or simulated: a `cell.devices.DrivenArm`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.arm.arm_state import lost_connection_error
from cell.arm.connection import ArmConnection
from cell.arm.control_program import DASHBOARD_S
from cell.arm.driver import ArmDriver
from cell.arm.fault_recovery import acknowledge_protective_stop
from cell.arm.motion import execute_move
from cell.arm.preflight import probe, resolve_host
from cell.arm.rtde_driver import UrDriver
from cell.config.arm_config import ArmSettings
from cell.devices import ArmInfo, ArmState
from cell.errors import MotionError, RobotNotReadyError, StoppedError
from cell.kinematics import ur_kinematics

MODEL_M = 0.05
"""Largest distance of the calibrated flange pose from the nominal one. Beyond it, the model is another one."""


class UrArm:
    """One UR arm.

    Every method but `stop` belongs to one thread at a time. `stop`, `host` and `latest` may be used from any thread.
    """

    def __init__(
        self, settings: ArmSettings, host: str, make_driver: Callable[[str, float], ArmDriver] = UrDriver
    ) -> None:
        """Create the arm; no connection is made before `connect`.

        Args:
            settings: Model, speeds and watchdog of the arm.
            host: Name or address of the controller.
            make_driver: Makes the driver in its child process, from the IP address and the watchdog frequency.
        """
        self.settings, self.host = settings, host
        self._link = ArmConnection(settings, make_driver)

    @property
    def latest(self) -> ArmState | None:
        """Last state that the arm reported, or None. Nothing is queried."""
        return self._link.latest

    def connect(self) -> ArmInfo:
        """Connect to the arm so that it can be moved. The arm does not move.

        Raises:
            RobotUnreachableError: No controller answers.
            RobotNotReadyError: The controller cannot be driven now, or is of another model.
            RobotLostError: The link broke.
            ProtectiveStopError: The robot is in a protective stop.
            EmergencyStopError: An emergency stop is pressed.
            StoppedError: `stop` was called meanwhile.
        """
        link = self._link
        link.stopped.clear()  # first: a `stop` from now on holds for this connection too
        ended_ours = link.program is not None and link.program.there
        link.release()
        address = resolve_host(self.host)
        info = probe(address, self.settings.model, ending_s=DASHBOARD_S if ended_ours else 0.0)
        self._check_model(link.open(address))
        if link.stopped.is_set():
            link.fail(StoppedError("the arm was stopped by request while it was being connected"))
        return info

    def check_ready(self) -> None:
        """Return if the arm can be moved now. Raise the errors of `move` otherwise; the connection is then over."""
        self._link.require_ready()

    def state(self) -> ArmState:
        """Return the arm's present state. The flange pose is that of the controller, whatever tool is set.

        Raises:
            RobotLostError: The link broke.
            RobotNotReadyError: The program of another client has taken the arm, or the arm is not connected.
            CellError: Why the connection ended before.
        """
        link = self._link
        if link.child is None:
            raise link.end_reason()
        reading = link.poll()
        error = lost_connection_error(reading)
        if error is not None:
            link.fail(error)
        if reading.program == "playing" and not reading.operating and not link.stopped.is_set():
            return link.at_rest()
        return link.update_state(reading)

    def move(self, q_rad: NDArray[np.float64]) -> ArmState:
        """Move to the joint angles (6,) and return the state at rest there.

        After every error but rejected angles, the arm is stopped and must be connected again.

        Raises:
            MotionError: The controller rejects the angles (nothing moves), or the arm does not reach its target.
            RobotLostError: The link broke, or the watchdog has ended the program.
            RobotNotReadyError: The controller cannot be driven now.
            ProtectiveStopError: The robot is in a protective stop.
            EmergencyStopError: An emergency stop is pressed.
            StoppedError: `stop` was called.
        """
        execute_move(self._link, self.settings, _joints(q_rad))
        return self.state()

    def stop(self) -> None:
        """Stop the arm. The stop is sent when this returns.

        A running move raises StoppedError then, and so does every later move until `connect`.
        """
        self._link.stop()

    def acknowledge(self) -> None:
        """End the program and unlock a protective stop, after a person has inspected the cell. The arm does not move.

        The robot must be connected again afterwards. The errors are those of `acknowledge_protective_stop`.
        """
        link = self._link
        program = link.program
        address = resolve_host(self.host) if program is None else program.address
        link.release()
        acknowledge_protective_stop(address, link.protective_s, program is not None and program.there)
        link.protective_s, link.program = None, None

    def close(self) -> None:
        """Release the arm. An arm that moves is stopped first."""
        self._link.stopped.set()
        if self._link.move_sent:
            self._link.stop()
        self._link.release()

    def _check_model(self, state: ArmState) -> None:
        T_nominal = ur_kinematics.forward(self.settings.model, state.q_rad)
        off_m = float(np.linalg.norm(T_nominal[:3, 3] - state.T_base_flange[:3, 3]))
        if off_m > MODEL_M:
            self._link.fail(
                RobotNotReadyError(
                    f"the robot's flange is {off_m * 1000:.0f} mm from the position that a "
                    f"{self.settings.model} would have: correct arm.model"
                )
            )


def _joints(q_rad: ArrayLike) -> NDArray[np.float64]:
    q = np.asarray(q_rad, dtype=np.float64)
    if q.shape != (6,) or not np.isfinite(q).all():
        raise MotionError(f"six joint angles are needed, finite and in radians; got {q.tolist()}")
    return q
