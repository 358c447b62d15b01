"""Check of a UR controller before a connection: may it be driven?

The check uses plain sockets with deadlines. The vendor's library would hang on a peer that accepts and never answers,
and would end the program of another client.
"""

import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import get_args

from cell.arm.dashboard import Dashboard, connected
from cell.arm.robot_modes import mode_error
from cell.config.arm_models import ArmModelName
from cell.devices import ArmInfo, RobotMode, SafetyMode
from cell.errors import CellError, RobotNotReadyError, RobotUnreachableError

PROBE_S = 2.0
"""Timeout of the whole check."""
RTDE_PORT = 30004
SCRIPT_PORT = 30003

_ASK_PROTOCOL_2 = struct.pack(">HBH", 5, ord("V"), 2)
_PROTOCOL_2 = struct.pack(">HBB", 4, ord("V"), 1)


def probe(address: str, model: ArmModelName, ending_s: float = 0.0) -> ArmInfo:
    """Return the identity of the controller, if it may be driven. The check changes nothing on the controller.

    Args:
        address: IP address of the controller.
        model: Configured model of the arm.
        ending_s: Time for which a program that is being ended may still be there.

    Raises:
        RobotUnreachableError: No controller answers, or the answer is not that of a UR controller.
        RobotNotReadyError: Local mode, power off, another program or another model.
        ProtectiveStopError: The robot is in a protective stop.
        EmergencyStopError: An emergency stop is pressed.
    """
    until_s = time.monotonic() + PROBE_S
    _answers_rtde(address, until_s)
    connected(address, SCRIPT_PORT, until_s).close()
    with Dashboard(address, until_s) as dashboard:
        info = read_identity(dashboard)
        for error in find_driving_errors(dashboard, info, model, ending_s):
            raise error
    return info


def read_identity(dashboard: Dashboard) -> ArmInfo:
    """Query the identity of the robot. Raise RobotUnreachableError without an answer."""
    return ArmInfo(
        model=dashboard.ask("get robot model"),
        serial=dashboard.ask("get serial number"),
        software=software_version(dashboard.ask("PolyscopeVersion")),
    )


def find_driving_errors(
    dashboard: Dashboard, info: ArmInfo, model: ArmModelName, ending_s: float = 0.0
) -> Iterator[CellError]:
    """Yield each reason why the robot must not or cannot be driven, checking one after the other.

    The arguments and the errors are those of `probe`.
    """
    if info.model.upper().removesuffix("E") != model.removesuffix("e").upper():
        yield RobotNotReadyError(
            f"the robot is a {info.model}, not {model!r} as arm.model says: correct arm.model, or arm.host"
        )
    if dashboard.ask("is in remote control").lower() != "true":
        yield RobotNotReadyError(
            "the robot is in local mode: switch it to remote control at the top right of its pendant (allow it once "
            "under Settings, System, Remote Control)"
        )
    error = mode_error(robot_mode(dashboard), safety_mode(dashboard))
    if error is not None:
        yield error
    program_gone_s = time.monotonic() + ending_s
    while (program := dashboard.ask("programState")).split(" ")[0] != "STOPPED":
        if time.monotonic() > program_gone_s:
            state, _, name = program.partition(" ")
            # the name of ur_rtde's program, which `pointchain serve` keeps on the robot
            who = "end the software that drives the robot already, or " if "rtde_control" in name else ""
            yield RobotNotReadyError(
                f"another program ({name or 'without a name'}) is on the robot, {state.lower()}: {who}stop it at the "
                "pendant first; this software does not end it"
            )
            return
        time.sleep(0.02)


def resolve_host(host: str, timeout_s: float = 0.8) -> str:
    """Return the IP address of a host. A resolver that hangs is abandoned in its thread.

    Raises:
        RobotUnreachableError: The name is unknown, or the name server does not answer within `timeout_s`.
    """
    answer: list[str | OSError] = []

    def look_up() -> None:
        try:
            answer.append(str(socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_STREAM)[0][4][0]))
        except (OSError, UnicodeError) as error:
            answer.append(error if isinstance(error, OSError) else OSError(str(error)))

    thread = threading.Thread(target=look_up, daemon=True)
    thread.start()
    thread.join(timeout_s)
    if answer and isinstance(answer[0], str):
        return answer[0]
    why = answer[0] if answer else "the name server does not answer"
    raise RobotUnreachableError(
        f"the robot's name {host!r} is not known ({why}): check arm.host, or give its IP address"
    )


def robot_mode(dashboard: Dashboard) -> RobotMode:
    """Query the robot mode. An unknown mode becomes `no_controller`."""
    said = dashboard.ask("robotmode").rpartition(":")[2].strip().lower()
    return next((mode for mode in get_args(RobotMode) if mode == said), "no_controller")


def safety_mode(dashboard: Dashboard) -> SafetyMode:
    """Query the safety mode. An unknown mode becomes `undefined`."""
    said = dashboard.ask("safetystatus").rpartition(":")[2].strip().lower()
    # kinds of safeguard stop with names of their own: a door in automatic mode, and two enabling switches
    if said in (
        "automatic_mode_safeguard_stop", "system_three_position_enabling_stop", "tp_three_position_enabling_stop",
    ):  # fmt: skip
        return "safeguard_stop"
    return next((mode for mode in get_args(SafetyMode) if mode == said), "undefined")


def software_version(said: str) -> str:
    """Return `5.25.1` for "URSoftware 5.25.1.123456 (Jan 01 2026)", or the whole text if it has another form."""
    words = [word for word in said.split() if word[:1].isdigit() and "." in word]
    return ".".join(words[0].split(".")[:3]) if words else said


def _answers_rtde(address: str, until_s: float) -> None:
    with connected(address, RTDE_PORT, until_s) as link:
        try:
            link.settimeout(max(until_s - time.monotonic(), 1e-3))
            link.sendall(_ASK_PROTOCOL_2)
            answer = link.recv(len(_PROTOCOL_2), socket.MSG_WAITALL)
        except OSError as error:
            raise RobotUnreachableError(
                f"{address} accepts connections on port {RTDE_PORT} but does not answer: restart the robot's "
                "controller if this stays"
            ) from error
    if answer != _PROTOCOL_2:
        raise RobotUnreachableError(
            f"what answers at {address}, port {RTDE_PORT}, is not a UR controller with RTDE protocol 2: check arm.host "
            "and that RTDE is allowed under Settings, Security, Services"
        )
