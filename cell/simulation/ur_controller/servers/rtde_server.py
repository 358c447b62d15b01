"""RTDE server: send the robot state at up to 500 Hz, and receive input registers."""

import asyncio
import math
import struct
from typing import Any

from cell.simulation.ur_controller.robot import urscript_program
from cell.simulation.ur_controller.robot.robot import CYCLE_HZ, Robot
from cell.simulation.ur_controller.servers import rtde_variables
from cell.simulation.ur_controller.servers.rtde_recipes import InputRecipe, OutputRecipe, input_recipe, output_recipe
from cell.simulation.ur_controller.servers.sockets import RTDE_PORT, Links

MIN_RATE_HZ = 1.0
UNSENT_BYTES = 200_000
"""Size of the send buffer. A client that lets it overflow is disconnected, as by a real controller."""
LONGEST_PACKAGE = 0xFFFF
ERROR, WARNING = 1, 2
COMMAND_REGISTER = "input_int_register_0"

_MASKED = {
    "standard_digital_output": ("standard_digital_output_mask", 0),
    "configurable_digital_output": ("configurable_digital_output_mask", 8),
    "tool_digital_output": ("tool_digital_output_mask", 16),
}
"""Mask variable and first bit of each group of digital outputs."""


class RtdeServer:
    """Server of all RTDE clients."""

    def __init__(self, robot: Robot, links: Links, version: tuple[int, int, int, int]) -> None:
        self.robot, self.links, self.version = robot, links, version
        self.clients: set[RtdeClient] = set()
        self.owners: dict[str, RtdeClient] = {}
        """Client that writes each input variable."""

    @property
    def streaming(self) -> bool:
        """Whether a client has started its output."""
        return any(client.started for client in self.clients)

    def send(self, step: int) -> None:
        """Send the packages that are due in a control cycle."""
        if self.links.frozen:
            return
        for client in list(self.clients):
            client.send(step)


class RtdeClient(asyncio.Protocol):
    """Connection of one RTDE client."""

    def __init__(self, server: RtdeServer) -> None:
        self._server, self._robot = server, server.robot
        self._buffer = bytearray()
        self._version = 1
        self._output: OutputRecipe | None = None
        self._inputs: dict[int, InputRecipe] = {}
        self._period_steps = 1
        self._due_step = 0
        """Control cycle of the next package."""
        self.started = False
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Handle the event of asyncio."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._peer = list(transport.get_extra_info("peername") or ())
        self._robot.log.add("connected", port=RTDE_PORT, peer=self._peer)
        if self._server.links.opened(transport, RTDE_PORT):
            self._server.clients.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Handle the event of asyncio."""
        self._robot.log.add("disconnected", port=RTDE_PORT, peer=self._peer)
        self._server.links.closed(self._transport)
        self._server.clients.discard(self)
        self._server.owners = {name: owner for name, owner in self._server.owners.items() if owner is not self}

    def data_received(self, data: bytes) -> None:
        """Handle the event of asyncio: process the complete packages."""
        self._buffer += data
        while len(self._buffer) >= 3:
            size, kind = struct.unpack_from(">HB", self._buffer)
            if size < 3:
                self._robot.log.add("rtde_refused", reason=f"a package of {size} bytes")
                self._transport.abort()
                return
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[3:size])
            del self._buffer[:size]
            self._take(chr(kind), payload)

    def send(self, step: int) -> None:
        """Send a package if one is due in a control cycle."""
        if not self.started or self._output is None or step < self._due_step:
            return
        links = self._server.links
        period = self._period_steps if links.rate_hz is None else max(self._period_steps, _steps(links.rate_hz))
        # A controller that was held up omits packages: the next one follows after a whole period.
        self._due_step = step + period
        if self._transport.get_write_buffer_size() > UNSENT_BYTES:
            self._robot.log.add("rtde_overflow", peer=self._peer)
            self._transport.abort()
            return
        package = self._output.package()
        if links.delay_s > 0:
            asyncio.get_running_loop().call_later(links.delay_s, self._write, package)
        else:
            self._transport.write(package)

    def _write(self, package: bytes) -> None:
        if not self._transport.is_closing():
            self._transport.write(package)

    def _answer(self, kind: str, payload: bytes) -> None:
        self._write(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def _complain(self, text: str, level: int = WARNING) -> None:
        self._robot.log.add("rtde_refused", reason=text)
        if self._version > 1:
            message, source = text.encode()[:255], b"RTDE"
            payload = bytes([len(message)]) + message + bytes([len(source)]) + source + bytes([level])
        else:
            payload = bytes([level]) + text.encode()[:255]
        self._answer("M", payload)

    def _take(self, kind: str, payload: bytes) -> None:
        try:
            match kind:
                case "U":
                    self._take_data(payload)
                case "V":
                    (requested,) = struct.unpack(">H", payload)
                    if accepted := requested in (1, 2):
                        self._version = requested
                    self._answer("V", bytes([accepted]))
                case "v":
                    self._answer("v", struct.pack(">4I", *self._server.version))
                case "M":
                    self._robot.log.add("rtde_text", text=payload.decode(errors="replace"))
                case "O":
                    self._set_up_outputs(payload)
                case "I":
                    self._set_up_inputs(payload)
                case "S":
                    self.started = self._output is not None and self._output.valid
                    self._due_step = 0
                    self._answer("S", bytes([self.started]))
                    self._robot.log.add("rtde_start", peer=self._peer, accepted=self.started)
                case "P":
                    self.started = False
                    self._answer("P", b"\x01")
                case _:
                    self._complain(f"unknown package type {ord(kind)}", ERROR)
        except (struct.error, UnicodeDecodeError, ValueError) as error:
            self._complain(f"a {kind} package that cannot be decoded: {error}", ERROR)

    def _set_up_outputs(self, payload: bytes) -> None:
        rate_hz = float(CYCLE_HZ)
        if self._version > 1:
            (rate_hz,) = struct.unpack_from(">d", payload)
            payload = payload[8:]
        names = _names(payload)
        if not (math.isfinite(rate_hz) and MIN_RATE_HZ <= rate_hz <= CYCLE_HZ and names):
            self._output = None
            self._answer("O", b"\x00" if self._version > 1 else b"")
            self._complain(
                f"{len(names)} variables at {rate_hz:g} Hz; {MIN_RATE_HZ:g} to {CYCLE_HZ} Hz are possible", ERROR
            )
            return
        self._period_steps = _steps(rate_hz)
        self._output = output_recipe(self._robot, names, self._version, self._server.version)
        if self._output.layout.size > LONGEST_PACKAGE:
            self._output = None
            self._answer("O", b"\x00" if self._version > 1 else b"")
            self._complain(f"{len(names)} variables do not fit into a package", ERROR)
            return
        head = bytes([self._output.recipe_id if self._output.valid else 0]) if self._version > 1 else b""
        self._answer("O", head + ",".join(self._output.types).encode())

    def _set_up_inputs(self, payload: bytes) -> None:
        owners = self._server.owners
        recipe = input_recipe(_names(payload), lambda name: owners.get(name, self) is not self)
        number = 0
        if recipe.valid and len(self._inputs) < 255:
            number = len(self._inputs) + 1
            self._inputs[number] = recipe
            owners.update(dict.fromkeys(recipe.names, self))
        else:
            self._robot.log.add("rtde_refused", reason=f"input recipe: {','.join(recipe.types)}")
        self._answer("I", bytes([number]) + ",".join(recipe.types).encode())

    def _take_data(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            self._complain("data for an input recipe that was not set up", ERROR)
            return
        if len(payload) != 1 + recipe.layout.size:
            self._complain(f"data of {len(payload)} bytes; the recipe has {1 + recipe.layout.size}", ERROR)
            return
        values = recipe.values(payload[1:])
        for name, value in values.items():
            rtde_variables.write_input(self._robot, name, value)
        self._set_outputs(values)
        if COMMAND_REGISTER in values:
            now_s = asyncio.get_running_loop().time()
            self._robot.watchdog.kick(now_s)
            if values[COMMAND_REGISTER] not in (0, urscript_program.KICK):
                self._robot.advance(now_s)  # a late cycle does not execute the command before its arrival
                self._robot.log.add("command", now_s, **_command(self._robot, values[COMMAND_REGISTER]))

    def _set_outputs(self, values: dict[str, Any]) -> None:
        if values.get("speed_slider_mask"):
            self._robot.arm.speed_fraction = min(1.0, max(0.0, values.get("speed_slider_fraction", 1.0)))
            self._robot.log.add("speed_slider", fraction=self._robot.arm.speed_fraction)
        for name, (mask_name, first) in _MASKED.items():
            if mask := values.get(mask_name):
                kept = self._robot.digital_outputs & ~(mask << first)
                self._robot.digital_outputs = kept | (values.get(name, 0) & mask) << first


def _steps(rate_hz: float) -> int:
    """Return the control cycles from one package to the next. The rate is not greater than the given one."""
    return math.ceil(CYCLE_HZ / rate_hz - 1e-9)


def _names(payload: bytes) -> list[str]:
    return [name.strip() for name in payload.decode("ascii").split(",") if name.strip()]


def _command(robot: Robot, number: int) -> dict[str, Any]:
    """Decode a command of the input registers for the log."""
    bank = robot.registers.inputs
    details: dict[str, Any] = {"number": number, "name": urscript_program.NAMES.get(number, "unknown")}
    if number in (1, 2, 3, 4):
        details |= {"target": bank.doubles[:6], "speed": bank.doubles[6], "acceleration": bank.doubles[7]}
    if number in (1, 2, 3, 4, 33, 34, 45):
        details["asynchronous"] = bank.integers[1] == 1
    if number in (33, 34, 35):
        details["value"] = bank.doubles[0]
    return details
