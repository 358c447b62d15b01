"""A UR arm as the rest of the cell sees it, real or simulated: an `Arm` of `cell.devices`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cell.arm.arm_reading import silence
from cell.arm.connection import ArmLink
from cell.arm.control_program import DASHBOARD_S
from cell.arm.driver import ArmDriver
from cell.arm.fault_recovery import acknowledge_protective_stop
from cell.arm.motion import watched_move
from cell.arm.preflight import probe, resolved
from cell.arm.rtde_driver import UrDriver
from cell.config.arm_config import ArmSettings
from cell.devices import ArmInfo, ArmState
from cell.errors import MotionError, RobotNotReadyError, StoppedError
from cell.kinematics import ur_kinematics

MODEL_M = 0.05
"""A calibrated flange pose further than this from the nominal one is another model's."""


class UrArm:
    """One UR arm. Every method but `stop` belongs to one thread at a time; `stop`, `host` and `latest` to any."""

    def __init__(
        self, settings: ArmSettings, host: str, make_driver: Callable[[str, float], ArmDriver] = UrDriver
    ) -> None:
        """Touches nothing yet. `host`: the controller's name or address."""
        self.settings, self.host = settings, host
        self._link = ArmLink(settings, make_driver)

    @property
    def latest(self) -> ArmState | None:
        """What the arm last told of itself; asks nothing."""
        return self._link.latest

    def connect(self) -> ArmInfo:
        """Takes the arm: after this it can be moved. It does not move.

        Raises: RobotUnreachableError, RobotNotReadyError, RobotLostError, ProtectiveStopError, EmergencyStopError;
        StoppedError when `stop` was called meanwhile.
        """
        link = self._link
        link.stopped.clear()  # first: whoever calls `stop` from now on means this connection too
        ended_ours = link.program is not None and link.program.there
        link.release()
        address = resolved(self.host)
        info = probe(address, self.settings.model, ending_s=DASHBOARD_S if ended_ours else 0.0)
        self._check_model(link.open(address))
        if link.stopped.is_set():
            link.fail(StoppedError("the arm was stopped by request while it was being connected"))
        return info

    def check_ready(self) -> None:
        """Returns if the arm can be moved now. Raises what `move` would, and like it ends the connection then."""
        self._link.ready()

    def state(self) -> ArmState:
        """The arm now; at rest, by the controller's own flange pose, whatever tool is set.

        Raises: RobotLostError; RobotNotReadyError when somebody else's program has taken the arm; or why the
        connection had ended before.
        """
        link = self._link
        if link.child is None:
            raise link.why_ended()
        reading = link.poll()
        error = silence(reading)
        if error is not None:
            link.fail(error)
        if reading.program == "playing" and not reading.operating and not link.stopped.is_set():
            return link.at_rest()
        return link.seen(reading)

    def move(self, q_rad: NDArray[np.float64]) -> ArmState:
        """Moves to the joint angles (6,) and returns the state at rest there.

        Raises:
            MotionError: the controller refuses the angles (nothing moved, and other moves are possible), or the arm
                does not move, or not to where it should.
            RobotLostError, ProtectiveStopError, EmergencyStopError, RobotNotReadyError: as it says; the arm is stopped,
                and must be connected again.
            StoppedError: after `stop`.
        """
        watched_move(self._link, self.settings, _joints(q_rad))
        return self.state()

    def stop(self) -> None:
        """Stops the arm at once: sent when this returns. A move under way raises StoppedError, and so does every later
        one until `connect`."""
        self._link.stop()

    def acknowledge(self) -> None:
        """A person has looked at the cell after a fault: ends the program and unlocks a protective stop. No motion.

        The robot must be connected again afterwards.

        Raises: TooEarlyError, RobotNotReadyError, ProtectiveStopError, EmergencyStopError, RobotUnreachableError.
        """
        link = self._link
        program = link.program
        address = resolved(self.host) if program is None else program.address
        link.release()
        acknowledge_protective_stop(address, link.protective_s, program is not None and program.there)
        link.protective_s, link.program = None, None

    def close(self) -> None:
        """Lets the arm go. A move under way is stopped first."""
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
                    f"the robot's flange is {off_m * 1000:.0f} mm from where that of a {self.settings.model} would be: "
                    "correct arm.model"
                )
            )


def _joints(q_rad: ArrayLike) -> NDArray[np.float64]:
    q = np.asarray(q_rad, dtype=np.float64)
    if q.shape != (6,) or not np.isfinite(q).all():
        raise MotionError(f"six joint angles are needed, finite and in radians; got {q.tolist()}")
    return q
