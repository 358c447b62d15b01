"""RTDE variables by name: their types and the sources of their values."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from cell.simulation.ur_controller.robot.poses import pose_vector
from cell.simulation.ur_controller.robot.robot import CYCLE_HZ, Robot
from cell.simulation.ur_controller.robot.states import RuntimeState

FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
    "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
"""RTDE types and their `struct` formats."""

Value = Sequence[float] | float
Getter = Callable[[Robot], Value]

_NUMBERED = re.compile(r"(input|output)_(bit|int|double)_register_(\d+)")
_WORD = re.compile(r"(input|output)_bit_registers(0_to_31|32_to_63)")
_ZERO6 = [0.0] * 6


def _all(names: str, kind: str, source: "Getter | Value") -> "dict[str, tuple[str, Getter | Value]]":
    """Return one entry for each of several names."""
    return dict.fromkeys(names.split(), (kind, source))


def _turning(robot: Robot) -> float:
    return float(robot.runtime is not RuntimeState.PAUSED)


OUTPUTS: dict[str, tuple[str, Getter | Value]] = {
    "timestamp": ("DOUBLE", lambda robot: robot.control_step / CYCLE_HZ),
    **_all("target_q actual_q", "VECTOR6D", lambda robot: robot.tool.q_rad),
    **_all("target_qd actual_qd", "VECTOR6D", lambda robot: robot.tool.qd_rad_s),
    **_all("target_TCP_pose actual_TCP_pose", "VECTOR6D", lambda robot: robot.tool.pose),
    **_all("target_TCP_speed actual_TCP_speed", "VECTOR6D", lambda robot: robot.tool.speed),
    "tcp_offset": ("VECTOR6D", lambda robot: pose_vector(robot.tool.T_flange_tcp)),
    "robot_mode": ("INT32", lambda robot: robot.mode.value),
    **_all("safety_mode safety_status", "INT32", lambda robot: robot.safety.value),
    "robot_status_bits": ("UINT32", lambda robot: robot.status_bits),
    "safety_status_bits": ("UINT32", lambda robot: robot.safety.bits),
    "runtime_state": ("UINT32", lambda robot: robot.runtime.value),
    "speed_scaling": ("DOUBLE", _turning),
    "target_speed_fraction": ("DOUBLE", lambda robot: robot.arm.speed_fraction),
    "actual_digital_output_bits": ("UINT64", lambda robot: robot.digital_outputs),
    "actual_configurable_digital_output_bits": ("UINT64", lambda robot: robot.digital_outputs >> 8 & 0xFF),
    "control_step": ("UINT64", lambda robot: robot.control_step),
    "payload": ("DOUBLE", lambda robot: robot.payload_kg),
    "payload_cog": ("VECTOR3D", lambda robot: robot.payload_cog_m),
    "joint_mode": ("VECTOR6INT32", [253] * 6),  # running
    "joint_temperatures": ("VECTOR6D", [30.0] * 6),
    "actual_joint_voltage": ("VECTOR6D", [48.0] * 6),
    "target_gravity": ("VECTOR3D", [0.0, 0.0, 9.82]),  # that of set_gravity() for an upright base
    "actual_tool_accelerometer": ("VECTOR3D", [0.0, 0.0, 9.81]),
    "tool_temperature": ("DOUBLE", 30.0),
    "tool_output_voltage": ("INT32", 0),
    "time_scale_source": ("INT32", -1),
    **_all("actual_main_voltage actual_robot_voltage", "DOUBLE", 48.0),
    **_all("elbow_position elbow_velocity", "VECTOR3D", [0.0] * 3),
    **_all(
        """target_qdd target_current target_moment actual_current actual_current_window actual_current_as_torque
        joint_control_output actual_TCP_force ft_raw_wrench actual_TCP_acceleration target_TCP_acceleration
        payload_inertia wrench_calc_from_currents target_base_acceleration target_base_wrench""",
        "VECTOR6D",
        _ZERO6,
    ),
    **_all(
        """actual_execution_time target_execution_time actual_momentum tcp_force_scalar actual_robot_current io_current
        tool_output_current tool_analog_input0 tool_analog_input1 standard_analog_input0 standard_analog_input1
        standard_analog_output0 standard_analog_output1 joint_position_deviation_ratio collision_detection_ratio
        actual_robot_energy_consumed actual_robot_braking_energy_dissipated euromap67_24V_voltage
        euromap67_24V_current""",
        "DOUBLE",
        0.0,
    ),
    **_all("actual_digital_input_bits actual_configurable_digital_input_bits", "UINT64", 0),
    **_all(
        """analog_io_types tool_mode tool_analog_input_types euromap67_input_bits euromap67_output_bits
        script_control_line""",
        "UINT32",
        0,
    ),
    **_all("encoder0_raw encoder1_raw", "INT32", 0),
    **_all("tool_output_mode tool_digital_output0_mode tool_digital_output1_mode", "UINT8", 0),
}
"""RTDE types of the output variables, with a getter or a constant.

The constants serve clients that request every variable.
"""

SINCE: dict[str, tuple[int, ...]] = {
    "actual_current_as_torque": (5, 23),
    "actual_robot_energy_consumed": (5, 23),
    "actual_robot_braking_energy_dissipated": (5, 23),
    "target_gravity": (5, 26),
    "target_base_acceleration": (5, 26),
    "target_base_wrench": (5, 26),
    "control_step": (5, 26),
}
"""First software version of the output variables that older controllers of the e-Series lack."""

INPUTS = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
}
"""RTDE types of the variables that a client may write, besides the input registers."""


def register_type(name: str, direction: str | None = None) -> str | None:
    """Return the type of a register by its name, or None if there is none (in the given direction)."""
    if word := _WORD.fullmatch(name):
        return "UINT32" if direction in (None, word[1]) else None
    numbered = _NUMBERED.fullmatch(name)
    if numbered is None or direction not in (None, numbered[1]):
        return None
    kind, number = numbered[2], int(numbered[3])
    if kind == "bit":
        return "BOOL" if 64 <= number <= 127 else None
    if number > 47:
        return None
    return "INT32" if kind == "int" else "DOUBLE"


@dataclass(frozen=True)
class RegisterSource:
    """Source of the value of one register, or of the values of consecutive ones."""

    bank: list[Any]
    """Registers of one type and direction."""
    first: int
    """Index of the first register."""
    count: int = 1
    """Number of registers."""

    def __call__(self) -> Any:
        """Return the value of one register, or the values of several."""
        if self.count == 1:
            return self.bank[self.first]
        return self.bank[self.first : self.first + self.count]


def _bank(robot: Robot, side: str, kind: str) -> list[Any]:
    bank = robot.registers.inputs if side == "input" else robot.registers.outputs
    return {"bit": bank.bits, "int": bank.integers, "double": bank.doubles}[kind]


def output(robot: Robot, name: str, software: tuple[int, ...]) -> tuple[str, Callable[[], Value] | Value] | None:
    """Return the type of an output variable and its getter or constant, or None if the software version lacks it."""
    if software < SINCE.get(name, ()):
        return None
    if name in OUTPUTS:
        kind, source = OUTPUTS[name]
        return kind, partial(source, robot) if callable(source) else source
    kind = register_type(name)
    if kind is None:
        return None
    if word := _WORD.fullmatch(name):
        bank = robot.registers.inputs if word[1] == "input" else robot.registers.outputs
        return kind, partial(bank.bits_word, 0 if word[2] == "0_to_31" else 32)
    numbered = _NUMBERED.fullmatch(name)
    assert numbered is not None
    return kind, RegisterSource(_bank(robot, numbered[1], numbered[2]), int(numbered[3]))


def input_type(name: str) -> str | None:
    """Return the type of an input variable, or None if the name is unknown."""
    return INPUTS.get(name) or register_type(name, "input")


def write_input(robot: Robot, name: str, value: Any) -> None:
    """Write a client's value to its register. Variables that are no registers are ignored here."""
    if word := _WORD.fullmatch(name):
        robot.registers.inputs.set_bits_word(0 if word[2] == "0_to_31" else 32, value)
    elif numbered := _NUMBERED.fullmatch(name):
        _bank(robot, "input", numbered[2])[int(numbered[3])] = value
