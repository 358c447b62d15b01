"""Client of the dashboard server of a UR controller, over a plain socket.

The client needs neither the vendor's library nor its process, so it works when those hang. Every command is a constant.
"""

import contextlib
import socket
import time
from types import TracebackType
from typing import Literal, Self

from cell.errors import RobotUnreachableError

PORT = 29999

Command = Literal[
    "robotmode", "safetystatus", "is in remote control", "programState", "get robot model", "get serial number",
    "PolyscopeVersion", "stop", "unlock protective stop", "close safety popup",
]  # fmt: skip

_LONGEST_LINE = 4096


class Dashboard:
    """One connection, which a `with` statement closes."""

    def __init__(self, host: str, until_s: float) -> None:
        """Connect to the dashboard server.

        Args:
            host: Name or address of the controller.
            until_s: Deadline for the connection and all answers, seconds of `time.monotonic()`.

        Raises:
            RobotUnreachableError: The dashboard server does not answer in time.
        """
        self._host, self._until_s = host, until_s
        self._received = b""
        self._socket = connected(host, PORT, until_s)
        try:
            self._line("greet")
        except RobotUnreachableError:
            self.close()
            raise

    def ask(self, command: Command) -> str:
        """Send one command and return the answer line. Raise RobotUnreachableError without an answer in time."""
        try:
            self._socket.settimeout(_left(self._until_s))
            self._socket.sendall(command.encode() + b"\n")
        except OSError as error:
            raise _silent(self._host, command) from error
        return self._line(command)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _line(self, asked: str) -> str:
        while b"\n" not in self._received:
            try:
                self._socket.settimeout(_left(self._until_s))
                data = self._socket.recv(_LONGEST_LINE)
            except OSError as error:
                raise _silent(self._host, asked) from error
            self._received += data
            if not data or len(self._received) > _LONGEST_LINE:
                raise _silent(self._host, asked)
        line, self._received = self._received.split(b"\n", 1)
        return line.decode("utf-8", "replace").strip()


def connected(host: str, port: int, until_s: float) -> socket.socket:
    """Return a new TCP connection.

    Args:
        host: Name or address of the controller.
        port: Port number.
        until_s: Deadline, seconds of `time.monotonic()`.

    Raises:
        RobotUnreachableError: The connection fails, or takes too long.
    """
    try:
        link = socket.create_connection((host, port), timeout=_left(until_s))
    except OSError as error:
        raise RobotUnreachableError(
            f"no robot answers at {host}, port {port} ({error}): check arm.host, that the robot's "
            "controller is switched on and booted, the network cable, and that no firewall is in between"
        ) from error
    with contextlib.suppress(OSError):  # the peer may have closed the socket
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return link


def stop_program(host: str, timeout_s: float) -> str:
    """End the running program, and with it its motion. Return the answer of the dashboard server.

    The command is sent as soon as the connection is open, before the greeting arrives.

    Args:
        host: Name or address of the controller.
        timeout_s: Timeout of the whole call.

    Raises:
        RobotUnreachableError: The dashboard server does not answer in time.
    """
    until_s = time.monotonic() + timeout_s
    with connected(host, PORT, until_s) as link:
        try:
            link.sendall(b"stop\n")
            # closing with unread data resets the connection, and the command might not be read
            received = b""
            while received.count(b"\n") < 2:
                link.settimeout(_left(until_s))
                data = link.recv(_LONGEST_LINE)
                if not data:
                    break
                received += data
        except OSError as error:
            raise _silent(host, "stop") from error
    lines = received.decode("utf-8", "replace").splitlines()
    return lines[1].strip() if len(lines) > 1 else ""


def no_program_left(answer: str) -> bool:
    """Return whether the answer to a stop says that no program is left. In local mode the robot rejects the stop."""
    return answer.lower().startswith(("stopped", "failed to execute"))  # the second means that there was no program


def _left(until_s: float) -> float:
    """Return the seconds until the deadline, at least a millisecond, because 0 makes a socket non-blocking."""
    return max(until_s - time.monotonic(), 1e-3)


def _silent(host: str, asked: str) -> RobotUnreachableError:
    return RobotUnreachableError(
        f"the robot's dashboard at {host}, port {PORT}, accepts connections but does not answer {asked!r}: restart the "
        "robot's controller if this stays"
    )
