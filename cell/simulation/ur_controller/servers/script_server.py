"""Script server: receive programs and run them. A program is recognised by its header, not interpreted."""

import asyncio
import re

from cell.simulation.ur_controller.robot.robot import ForeignProgram, Robot
from cell.simulation.ur_controller.robot.urscript_program import ControlProgram
from cell.simulation.ur_controller.servers.sockets import SCRIPT_PORT, Links

HEADER = re.compile(rb"^(def|sec) +(\w+) *\( *\) *:[ \t]*\r?$")
LONGEST_BYTES = 1_000_000


class ScriptServer(asyncio.Protocol):
    """Connection to the script port."""

    def __init__(self, robot: Robot, links: Links) -> None:
        self._robot, self._links = robot, links
        self._buffer = b""
        self._program: list[bytes] = []
        """Lines of the program that is being received."""
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Handle the event of asyncio."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._peer = list(transport.get_extra_info("peername") or ())
        self._robot.log.add("connected", port=SCRIPT_PORT, peer=self._peer)
        self._links.opened(transport, SCRIPT_PORT)

    def connection_lost(self, exc: Exception | None) -> None:
        """Handle the event of asyncio."""
        self._robot.log.add("disconnected", port=SCRIPT_PORT, peer=self._peer)
        self._links.closed(self._transport)

    def data_received(self, data: bytes) -> None:
        """Handle the event of asyncio: process the complete lines."""
        # The last line of an upload may lack its line break.
        self._buffer += data
        *lines, self._buffer = self._buffer.split(b"\n")
        if self._buffer.rstrip() == b"end":
            lines, self._buffer = [*lines, self._buffer], b""
        for line in lines:
            self._take(line)
        if len(self._buffer) + sum(map(len, self._program)) > LONGEST_BYTES:
            self._robot.log.add("script_refused", name="", reason="too long")
            self._transport.abort()

    def _take(self, line: bytes) -> None:
        if self._program:
            self._program.append(line)
            if line.rstrip() == b"end":
                lines, self._program = self._program, []
                self._start(b"\n".join(lines))
        elif HEADER.match(line):
            self._program = [line]
        elif line.strip() and not line.lstrip().startswith(b"#"):
            text = line.decode(errors="replace")[:200]
            self._robot.log.add("script_ignored", text=text, reason="single lines are not simulated")

    def _start(self, program: bytes) -> None:
        header = HEADER.match(program.split(b"\n", 1)[0])
        assert header is not None
        kind, name = header[1].decode(), header[2].decode()
        if kind == "sec":
            self._robot.log.add("script_ignored", text=name, reason="secondary programs are not simulated")
            return
        self._robot.advance(asyncio.get_running_loop().time())
        reason = self._robot.why_no_program()
        if reason is not None:
            self._robot.log.add("script_refused", name=name, reason=reason)
            return
        self._robot.log.add("script_upload", name=name, bytes=len(program))
        if name == ControlProgram.name:
            self._robot.run_program(ControlProgram(self._robot, program.decode(errors="replace")))
        else:
            self._robot.run_program(ForeignProgram(name))
