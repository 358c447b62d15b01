"""The program that ur_rtde uploads: commands in the input registers, responses in the output registers.

The program is recognised, not interpreted: this file reimplements its main loop. As in the original, a command is read
once until the register returns to 0. A synchronous move blocks the loop until it ends, so that a stop of such a move is
only read after the arm has arrived.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np

from calibration.geometry.transforms import inverse
from cell.kinematics import ur_kinematics
from cell.simulation.ur_controller.robot.arm import Arm, Goal, UnreachableGoalError
from cell.simulation.ur_controller.robot.event_log import EventLog
from cell.simulation.ur_controller.robot.poses import nearest_solution, pose_matrix, pose_vector
from cell.simulation.ur_controller.robot.registers import Registers
from cell.simulation.ur_controller.robot.safety_limits import SafetyLimits
from cell.simulation.ur_controller.robot.targets import joint_goal, line_goal, path_goals
from cell.simulation.ur_controller.robot.tcp import Tool
from cell.simulation.ur_controller.robot.trajectories import Joints

NAMES = {
    1: "movej", 2: "movej_ik", 3: "movel", 4: "movel_fk", 6: "force_mode", 7: "force_mode_stop", 8: "zero_ftsensor",
    9: "speedj", 10: "speedl", 11: "servoj", 12: "servoc", 15: "speed_stop", 16: "servo_stop", 17: "set_payload",
    18: "teach_mode", 19: "end_teach_mode", 20: "force_mode_set_damping", 21: "force_mode_set_gain_scaling",
    24: "servol", 25: "tool_contact", 26: "get_steptime", 27: "get_actual_joint_positions_history",
    28: "get_target_waypoint", 29: "set_tcp", 30: "get_inverse_kin", 31: "protective_stop", 33: "stopl", 34: "stopj",
    35: "set_watchdog", 36: "is_pose_within_safety_limits", 37: "is_joints_within_safety_limits",
    38: "get_joint_torques", 39: "pose_trans", 40: "get_tcp_offset", 41: "start_jog", 42: "stop_jog",
    43: "get_forward_kin", 44: "get_forward_kin", 45: "move_path", 46: "get_inverse_kin", 47: "is_steady",
    51: "move_until_contact", 52: "freedrive_mode", 53: "end_freedrive_mode", 54: "get_freedrive_status",
    56: "ft_rtde_input_enable", 57: "enable_external_ft_sensor", 58: "get_actual_tool_flange_pose", 59: "set_gravity",
    60: "get_inverse_kin_has_solution", 61: "get_inverse_kin_has_solution", 62: "start_contact_detection",
    63: "stop_contact_detection", 64: "read_contact_detection", 65: "set_target_payload", 99: "kick_watchdog",
    255: "stop_script",
}  # fmt: skip
"""Names of the commands by number. Commands that the simulation does not know are acknowledged without effect."""

REALTIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands that need no return to 0 before the next command."""
READY, DONE = 1, 2
KICK, STOP_SCRIPT = 99, 255
STEADY_RAD_S = 1e-3
STEPTIME_S = 0.002


class ProgrammedRobot(Protocol):
    """The robot, as a program uses it."""

    arm: Arm
    """Joints and their moves."""
    tool: Tool
    """Tool on the flange."""
    log: EventLog
    """Log of events."""
    limits: SafetyLimits
    """Safety limits."""
    registers: Registers
    """General purpose registers."""
    payload_kg: float
    """Mass of the payload."""
    payload_cog_m: list[float]
    """Centre of gravity of the payload (3,)."""

    def protective_stop(self, cause: str) -> None:
        """Stop the arm by the safety system, and pause the program."""
        ...

    def arm_watchdog(self, hz: float) -> None:
        """Start the watchdog with this frequency."""
        ...


class ScriptError(Exception):
    """A runtime error, which ends the program."""


class ControlProgram:
    """The control program of ur_rtde. One `next` of `run` is one cycle of the controller."""

    name = "rtde_control"

    def __init__(self, robot: ProgrammedRobot, text: str) -> None:
        """Create the program.

        Args:
            robot: Robot that the program moves.
            text: Uploaded script, which contains the path of a path move.
        """
        self._robot, self._text = robot, text
        self._in, self._out = robot.registers.inputs, robot.registers.outputs
        self._writes = 0
        self._operation = 0
        self._asynchronous: str | None = None
        """Kind of a running thread of the program, "move" or "stop", or None."""
        self._stop_with_tool = False
        self._quick = self._quick_commands()

    def run(self) -> Iterator[None]:
        """Run the main loop until the program ends. Raise ScriptError on a runtime error."""
        executing = False
        self._asynchronous_status(-1)
        self._out.integers[0] = READY
        while True:
            self._watch_thread()
            command = self._in.integers[0]
            if command == 0:
                executing = False
                self._out.integers[0] = READY
            elif command in REALTIME:
                yield from self._process(command)
                self._out.integers[0] = READY
            elif not executing:
                executing = True
                if command == STOP_SCRIPT:
                    return
                yield from self._process(command)
                self._out.integers[0] = DONE
            yield

    def _asynchronous_status(self, value: int) -> None:
        """Set the progress register. 0 starts an operation, and -1 ends it."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        running = (1 << 15) + min(value, 0x7FFF) if value >= 0 else 0
        self._out.integers[2] = (self._operation << 24) + (self._writes << 16) + running

    def _watch_thread(self) -> None:
        if self._asynchronous is not None and not self._robot.arm.busy:
            self._asynchronous = None
            self._asynchronous_status(-1)

    def _kill_thread(self) -> None:
        if self._asynchronous is not None:
            self._asynchronous = None
            self._asynchronous_status(-1)

    def _until_still(self) -> Iterator[None]:
        while self._robot.arm.busy:
            yield

    def _vector(self, first: int) -> Joints:
        return np.array(self._in.doubles[first : first + 6])

    def _answer(self, values: "Sequence[float] | Joints") -> None:
        self._out.doubles[:6] = [float(value) for value in values]

    def _answer_truth(self, truth: bool) -> None:
        self._out.integers[1] = int(truth)

    def _process(self, command: int) -> Iterator[None]:
        match command:
            case 1 | 2 | 3 | 4:
                yield from self._move(command)
            case 33 | 34:
                yield from self._stop(self._in.integers[1] == 1, self._in.doubles[0])
            case 45:
                self._kill_thread()
                for k, goal in enumerate(path_goals(self._robot.arm.model, self._robot.tool, self._text)):
                    self._asynchronous_status(k)
                    yield from self._go(goal)
                    yield from self._until_still()
            case _ if command in self._quick:
                self._quick[command]()
            case _ if command != KICK:
                self._robot.log.add("command_without_effect", number=command, name=NAMES.get(command, "unknown"))

    def _quick_commands(self) -> dict[int, Callable[[], None]]:
        """Return the commands that are executed at once, by number."""
        robot, doubles = self._robot, self._in.doubles
        model = robot.arm.model

        def set_tcp() -> None:
            robot.tool.T_flange_tcp = pose_matrix(doubles[:6])

        def set_payload() -> None:
            robot.payload_kg = doubles[0]
            if any(doubles[1:4]):
                robot.payload_cog_m = doubles[1:4]

        def inverse_kinematics(q_near: Joints) -> None:
            q = self._solution(q_near)
            if q is None:
                raise ScriptError("get_inverse_kin: the pose is out of reach")
            self._answer(q)

        def pose_is_safe() -> bool:
            q = self._solution(robot.arm.q)
            return q is not None and robot.limits.violation(model, q) is None

        return {
            8: lambda: None,
            17: set_payload,
            65: set_payload,
            26: lambda: self._answer([STEPTIME_S, *self._out.doubles[1:6]]),
            27: lambda: self._answer(robot.arm.q),
            28: lambda: self._answer(robot.tool.pose),
            29: set_tcp,
            30: lambda: inverse_kinematics(self._vector(6)),
            46: lambda: inverse_kinematics(robot.arm.q),
            60: lambda: self._answer_truth(self._solution(robot.arm.q) is not None),
            61: lambda: self._answer_truth(self._solution(self._vector(6)) is not None),
            31: lambda: robot.protective_stop("protective_stop() called by the program"),
            35: lambda: robot.arm_watchdog(doubles[0]),
            36: lambda: self._answer_truth(pose_is_safe()),
            37: lambda: self._answer_truth(robot.limits.violation(model, self._vector(0)) is None),
            38: lambda: self._answer([0.0] * 6),
            39: lambda: self._answer(pose_vector(pose_matrix(doubles[:6]) @ pose_matrix(doubles[6:12]))),
            40: lambda: self._answer(pose_vector(robot.tool.T_flange_tcp)),
            43: lambda: self._answer(robot.tool.pose),
            44: lambda: self._answer(
                pose_vector(ur_kinematics.forward(model, self._vector(0)) @ pose_matrix(doubles[6:12]))
            ),
            47: lambda: self._answer_truth(bool(np.abs(robot.arm.qd).max() < STEADY_RAD_S)),
            58: lambda: self._answer(pose_vector(robot.arm.T_base_flange)),
            59: lambda: None,
        }

    def _solution(self, q_near: Joints) -> Joints | None:
        T_base_flange = pose_matrix(self._in.doubles[:6]) @ inverse(self._robot.tool.T_flange_tcp)
        return nearest_solution(self._robot.arm.model, T_base_flange, q_near)

    def _move(self, command: int) -> Iterator[None]:
        speed, acceleration = self._in.doubles[6:8]
        if not (speed > 0 and acceleration > 0):
            raise ScriptError(f"{NAMES[command]}: speed {speed:g} and acceleration {acceleration:g} must be positive")
        target: Joints | None = self._vector(0)
        if not np.isfinite(target).all():
            raise ScriptError(f"{NAMES[command]}: the target {target.tolist()} is not a pose")
        if command == 2:
            target = self._solution(self._robot.arm.q)
            if target is None:
                raise ScriptError("get_inverse_kin: the pose is out of reach")
        if command in (1, 2):
            goal = joint_goal(target, speed, acceleration)
        else:
            T = pose_matrix(target.tolist()) if command == 3 else self._robot.tool.at(target)
            goal = line_goal(self._robot.arm.model, self._robot.tool, T, speed, acceleration)
        self._kill_thread()
        asynchronous = self._in.integers[1] == 1
        if asynchronous:
            self._asynchronous = "move"
            self._asynchronous_status(0)
        yield from self._go(goal)
        if not asynchronous:
            yield from self._until_still()

    def _go(self, goal: Goal) -> Iterator[None]:
        """Move the arm to a target.

        If it is out of reach, the safety system pauses the program, which tries again when resumed.
        """
        while True:
            try:
                self._robot.arm.go(goal)
            except UnreachableGoalError as error:
                self._robot.protective_stop(str(error))
                yield
            else:
                return

    def _stop(self, asynchronous: bool, deceleration: float) -> Iterator[None]:
        """Stop the arm. As in the original, the kind of the stop depends on earlier stops and not on the command."""
        self._kill_thread()
        if asynchronous:
            self._stop_with_tool = True
            self._asynchronous = "stop"
            self._asynchronous_status(0)
        if self._stop_with_tool:
            self._robot.arm.brake_tool(deceleration, "stopl")
        else:
            self._robot.arm.brake(deceleration, "stopj")
        if not asynchronous:
            yield from self._until_still()
