"""States of the controller and their changes: power, safety, remote control and program."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cell.config.arm_models import ArmModelName
from cell.simulation.kinematic_error import KinematicError
from cell.simulation.ur_controller.robot.arm import HANDOVER_RAD_S2, PROTECTIVE_RAD_S2, Arm, Goal, UnreachableGoalError
from cell.simulation.ur_controller.robot.event_log import EventLog
from cell.simulation.ur_controller.robot.registers import Registers
from cell.simulation.ur_controller.robot.safety_limits import SafetyLimits
from cell.simulation.ur_controller.robot.states import OperationalMode, RobotMode, RuntimeState, SafetyMode
from cell.simulation.ur_controller.robot.tcp import Tool
from cell.simulation.ur_controller.robot.trajectories import Joints
from cell.simulation.ur_controller.robot.urscript_program import ControlProgram, ScriptError
from cell.simulation.ur_controller.robot.watchdog import Watchdog

CYCLE_HZ = 500
"""Frequency of the control cycle."""
UNLOCK_AFTER_S = 5.0
"""Time after a protective stop during which it cannot be unlocked."""
POWER_STEP_S = 0.3
"""Time from power off to idle, and from idle to running. Real arms take some seconds."""
START_S = 0.01
"""Time from the upload of a program to its first cycle."""


@dataclass(frozen=True)
class ForeignProgram:
    """Program of another client. It runs without effect until it is stopped."""

    name: str

    def run(self) -> Iterator[None]:
        """Yield at each cycle."""
        while True:
            yield


class Robot:
    """One robot with arm, registers and states. Its time is set by `begin_cycle` and `advance`."""

    def __init__(
        self,
        model: ArmModelName,
        q_rad: Joints,
        time_factor: float,
        limits: SafetyLimits,
        log: EventLog,
        now_s: float,
        error: KinematicError | None = None,
    ) -> None:
        self.log, self.limits = log, limits
        self.arm = Arm(model, q_rad, time_factor, log, now_s)
        self.tool = Tool(self.arm, error)
        self.registers = Registers()
        self.watchdog = Watchdog()
        self.started_s = self.now_s = now_s
        self.control_step = 0
        """Number of the current control cycle since the start."""
        self.mode, self.safety, self.runtime = RobotMode.RUNNING, SafetyMode.NORMAL, RuntimeState.STOPPED
        self.remote = True
        """Whether the robot is in remote control, in which scripts and dashboard commands are executed."""
        self.operational_mode = OperationalMode.NONE
        """Operational mode that the dashboard has set, or NONE."""
        self.loaded: str | None = None
        """Program that is loaded at the pendant, or None."""
        self.program: ControlProgram | ForeignProgram | None = None
        self.payload_kg, self.payload_cog_m = 0.0, [0.0, 0.0, 0.0]
        self.digital_outputs = 0
        """Digital outputs: bits 0-7 standard, 8-15 configurable, 16-17 tool."""
        self.planned_stops_s: list[float] = []
        """Times at which the safety system will stop the arm."""
        self.planned_stop_shares: list[float] = []
        """Shares of a move at which the safety system will stop the arm."""
        self._cycles: Iterator[None] | None = None
        self._program_start_s = 0.0
        self._paused_goal: Goal | None = None
        self._protective_s = -np.inf
        self._powering: tuple[float, RobotMode] | None = None
        self._is_release_pending = False
        """Whether the brakes are released as soon as the arm is idle."""

    @property
    def status_bits(self) -> int:
        """RTDE's robot_status_bits."""
        powered = self.mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)
        return int(powered) | (int(self.program is not None) << 1)

    def step_at(self, now_s: float) -> int:
        """Return the number of the control cycle at a time."""
        return int((now_s - self.started_s) * CYCLE_HZ + 1e-6)

    def time_of(self, step: int) -> float:
        """Return the time at which a control cycle begins."""
        return self.started_s + step / CYCLE_HZ

    def begin_cycle(self, step: int) -> None:
        """Advance arm, safety and power to the begin of a control cycle."""
        self.control_step = step
        self.advance(self.time_of(step))

    def advance(self, now_s: float) -> None:
        """Advance arm, safety and power to `now_s`. Time does not go back."""
        now_s = max(now_s, self.now_s)
        if self.planned_stops_s or self.planned_stop_shares:
            self._make_planned_stops(now_s)
        self._advance(now_s)

    def _make_planned_stops(self, now_s: float) -> None:
        for planned, moment in ((self.planned_stops_s, float), (self.planned_stop_shares, self.arm.moment_of)):
            for stop in list(planned):
                stop_s = moment(stop)
                if stop_s is not None and stop_s <= now_s:
                    planned.remove(stop)
                    self._advance(stop_s)
                    self.protective_stop("requested")

    def _advance(self, now_s: float) -> None:
        self.now_s = now_s
        moving = not self.arm.still
        try:
            self.arm.advance(now_s)
        except UnreachableGoalError as error:
            self.protective_stop(str(error))
        if moving and self.safety is SafetyMode.NORMAL:
            violation = self.limits.violation(self.arm.model, self.arm.q)
            if violation is not None:
                self.protective_stop(violation)
        if self.runtime is RuntimeState.STOPPING and self.arm.still:
            self._set_runtime(RuntimeState.STOPPED)
        if self._powering is not None and now_s >= self._powering[0]:
            self._set_mode(self._powering[1])
            self._power_next()

    def _power_next(self) -> None:
        """Plan the mode that follows the current one while the power comes on."""
        following = None
        if self.mode is RobotMode.POWER_ON:
            following = RobotMode.IDLE
        elif self.mode is RobotMode.IDLE and self._is_release_pending:
            following, self._is_release_pending = RobotMode.RUNNING, False
        self._powering = None if following is None else (self.now_s + POWER_STEP_S, following)

    def cycle(self) -> None:
        """Run one cycle of the program."""
        if self.runtime is not RuntimeState.PLAYING or self._cycles is None or self.now_s < self._program_start_s:
            return
        if self.watchdog.expired(self.now_s):
            watchdog = self.watchdog
            silence_s, excused_s = watchdog.silence_s(self.now_s), watchdog.excused_s
            self.log.add("watchdog_expired", self.now_s, hz=watchdog.hz, silence_s=silence_s, excused_s=excused_s)
            self.stop_program("watchdog")
            return
        try:
            next(self._cycles)
        except StopIteration:
            self.stop_program("ended")
        except ScriptError as error:
            self.log.add("script_error", self.now_s, error=str(error))
            self.stop_program("script error")

    def arm_watchdog(self, hz: float) -> None:
        """Start the watchdog for the program with this frequency."""
        self.watchdog.arm(hz, self.now_s)
        self.log.add("watchdog_armed", self.now_s, hz=hz)

    def why_no_program(self) -> str | None:
        """Return what prevents the start of a program now, or None."""
        if not self.remote:
            return "not in remote control"
        if self.mode is not RobotMode.RUNNING:
            return f"robot mode {self.mode.name}"
        if self.safety not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            return f"safety mode {self.safety.name}"
        return None

    def run_program(self, program: ControlProgram | ForeignProgram) -> None:
        """Start a program. A running program is killed."""
        if self.program is not None:
            self.log.add("program_killed", self.now_s, name=self.program.name, by=program.name)
            self.stop_program("killed by another program")
        self.program, self._cycles = program, program.run()
        self._program_start_s = self.now_s + START_S
        self.watchdog.arm(0.0, self.now_s)
        self._set_runtime(RuntimeState.PLAYING)

    def stop_program(self, reason: str) -> bool:
        """End the program; the arm brakes. Return False without a program."""
        if self.program is None:
            return False
        self.log.add("program_stopped", self.now_s, name=self.program.name, reason=reason)
        self.program, self._cycles, self._paused_goal = None, None, None
        self.watchdog.hz = 0.0
        self.arm.brake(HANDOVER_RAD_S2, reason)
        self._set_runtime(RuntimeState.STOPPED if self.arm.still else RuntimeState.STOPPING)
        return True

    def pause_program(self, deceleration_rad_s2: float, reason: str) -> bool:
        """Pause the program and its move. Return False if none is playing."""
        playing = self.runtime is RuntimeState.PLAYING
        goal = self.arm.pause(deceleration_rad_s2, reason)
        if playing:
            self._paused_goal = goal
            self._set_runtime(RuntimeState.PAUSED)
        return playing

    def play(self) -> bool:
        """Continue a paused program and its move, or start the loaded program. Return False if neither is possible."""
        if self.why_no_program() is not None:
            return False
        if self.runtime is RuntimeState.PAUSED:
            self.watchdog.kick(self.now_s)
            self._set_runtime(RuntimeState.PLAYING)
            goal, self._paused_goal = self._paused_goal, None
            if goal is not None:
                try:
                    self.arm.go(goal)
                except UnreachableGoalError as error:
                    self.protective_stop(str(error))
            return True
        if self.program is None and self.loaded is not None:
            self.run_program(ForeignProgram(self.loaded))
            return True
        return False

    def protective_stop(self, cause: str) -> None:
        """Stop the arm by the safety system, and pause the program."""
        if self.safety is not SafetyMode.NORMAL:
            return
        self._protective_s = self.now_s
        self._set_safety(SafetyMode.PROTECTIVE_STOP, cause)
        self.pause_program(PROTECTIVE_RAD_S2, "protective stop")

    def unlock(self) -> bool:
        """Unlock a protective stop; the program stays paused. Return False if it is too early."""
        if self.now_s - self._protective_s < UNLOCK_AFTER_S:
            return False
        if self.safety is SafetyMode.PROTECTIVE_STOP:
            self._set_safety(SafetyMode.NORMAL, "unlocked")
        return True

    def emergency_stop(self, pressed: bool) -> None:
        """Press or release the emergency stop button. After the release, the arm is still without power."""
        if not pressed:
            if self.safety is SafetyMode.ROBOT_EMERGENCY_STOP:
                self._set_safety(SafetyMode.NORMAL, "released")
            return
        self._set_safety(SafetyMode.ROBOT_EMERGENCY_STOP, "pressed")
        self.arm.brake(PROTECTIVE_RAD_S2, "emergency stop")
        self.stop_program("emergency stop")
        self.power_off()

    def power_off(self) -> None:
        """Switch off the power of the arm, which brakes."""
        self.arm.brake(PROTECTIVE_RAD_S2, "power off")
        self.stop_program("power off")
        self._powering, self._is_release_pending = None, False
        self._set_mode(RobotMode.POWER_OFF)

    def power_on(self) -> None:
        """Switch on the power, to idle with closed brakes."""
        if self.mode is RobotMode.POWER_OFF and self.safety is SafetyMode.NORMAL and self._powering is None:
            self._powering = (self.now_s + POWER_STEP_S, RobotMode.POWER_ON)

    def release_brakes(self) -> None:
        """Release the brakes, from idle to running. An arm without power gets it first."""
        if self.safety is not SafetyMode.NORMAL or self.mode is RobotMode.RUNNING:
            return
        if self.mode is RobotMode.IDLE:
            self._powering = self._powering or (self.now_s + POWER_STEP_S, RobotMode.RUNNING)
            return
        self._is_release_pending = True
        self.power_on()

    def restart_safety(self) -> None:
        """Restart the safety system. The arm is without power afterwards; a pressed emergency stop stays pressed."""
        self.power_off()
        if self.safety is not SafetyMode.ROBOT_EMERGENCY_STOP:
            self._set_safety(SafetyMode.NORMAL, "safety system restarted")

    def set_right(self, q_rad: Joints | None = None) -> None:
        """Restore power, safety and remote control, and end the program, as a person at the pendant would."""
        self.stop_program("put right")
        self.arm.place(self.arm.q if q_rad is None else q_rad)
        self.arm.speed_fraction, self.digital_outputs = 1.0, 0
        self.registers.outputs.clear()
        self.tool.T_flange_tcp, self.remote, self.loaded = np.eye(4), True, None
        self.operational_mode = OperationalMode.NONE
        self._powering, self._is_release_pending = None, False
        self._set_mode(RobotMode.RUNNING)
        self._set_safety(SafetyMode.NORMAL, "put right")
        self._set_runtime(RuntimeState.STOPPED)

    def _set_mode(self, mode: RobotMode) -> None:
        if mode is not self.mode:
            self.mode = mode
            self.log.add("robot_mode", self.now_s, mode=mode.name)

    def _set_safety(self, safety: SafetyMode, cause: str) -> None:
        if safety is not self.safety:
            self.safety = safety
            self.log.add("safety", self.now_s, mode=safety.name, cause=cause)

    def _set_runtime(self, runtime: RuntimeState) -> None:
        if runtime is not self.runtime:
            self.runtime = runtime
            name = None if self.program is None else self.program.name
            self.log.add("program_state", self.now_s, state=runtime.name, name=name)
