"""A client of the virtual controller's own port: its state, its log, and faults on demand.

For tests, and for the simulated camera, which asks where the flange is. Lines of JSON; standard library and numpy.
"""

import json
import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cell.simulation.ur_controller.servers.sockets import ADMIN_PORT


class ControllerGoneError(ConnectionError):
    """No virtual controller answers at the address."""


class AdminRefusedError(ValueError):
    """The controller did not understand what was asked."""


@dataclass(frozen=True, eq=False)
class ControllerState:
    """The virtual robot at one moment."""

    stamp_s: float
    """Of `time.monotonic()`, which all processes of a Linux machine share."""
    q_rad: NDArray[np.float64]
    """(6,)"""
    qd_rad_s: NDArray[np.float64]
    """(6,) by the wall clock: the time factor is in it."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) actual flange pose."""
    robot_mode: str
    """As "RUNNING"."""
    safety_mode: str
    """As "NORMAL", "PROTECTIVE_STOP"."""
    program_state: str
    """As "PLAYING", "PAUSED", "STOPPED"."""
    program: str | None
    """Its name."""
    moving: bool
    progress: float
    """Share of the move under way that is done, 0 to 1."""
    watchdog_hz: float
    """0 while it is not armed."""
    watchdog_fed_s: float
    """When it was last fed, of the same clock as `stamp_s`."""
    watchdog_meals: int
    """How often it was fed since it was armed."""
    remote: bool
    speed_fraction: float
    events: int
    """How many the log has had: `log(since=events)` gives what comes later."""
    connections: dict[str, int]
    """How many there are of each port: "rtde", "script", "dashboard"."""


class AdminClient:
    """Asks the virtual controller at an address. Connects at the first call; safe to use from several threads."""

    def __init__(self, host: str, timeout_s: float = 5.0) -> None:
        self.host = host
        self._timeout_s = timeout_s
        self._turn = threading.Lock()
        self._socket: socket.socket | None = None
        self._rest = b""

    def state(self) -> ControllerState:
        """The robot now. Raises ControllerGoneError."""
        answer = self._call("state")
        for name in ("q_rad", "qd_rad_s", "T_base_flange"):
            answer[name] = np.array(answer[name])
        return ControllerState(**answer)

    def pose(self) -> NDArray[np.float64]:
        """The actual `T_base_flange` (4, 4) now, by the clock and not by the last cycle. Raises ControllerGoneError."""
        return np.array(self._call("pose")["T_base_flange"])

    def log(self, since: int = 0) -> list[dict[str, Any]]:
        """The events from number `since` on: index, stamp_s (`time.monotonic()`), kind, details.

        The oldest of very many are forgotten.
        """
        return self._call("log", since=since)

    def drop(self) -> None:
        """Resets all RTDE connections, once."""
        self._call("drop")

    def freeze(self) -> None:
        """RTDE falls silent both ways, the sockets stay open; until `clear`."""
        self._call("freeze")

    def half_open(self) -> None:
        """New connections are accepted and never answered; until `clear`."""
        self._call("half_open")

    def unreachable(self) -> None:
        """All connections are reset and new ones refused; until `clear`."""
        self._call("unreachable")

    def slow(self, delay_s: float = 0.0, rate_hz: float | None = None) -> None:
        """RTDE packages leave later, or more seldom; until `clear`."""
        self._call("slow", delay_s=delay_s, rate_hz=rate_hz)

    def protective_stop(self, after_s: float = 0.0, at_share: float | None = None) -> None:
        """The safety system stops the arm: now, after a time, or when this share of the (next) move is done."""
        self._call("protective_stop", after_s=after_s, at_share=at_share)

    def emergency_stop(self) -> None:
        """The red button, pressed until `clear`."""
        self._call("emergency_stop")

    def local_mode(self) -> None:
        """Somebody takes the pendant: local control until `clear`."""
        self._call("local_mode")

    def foreign_program(self, name: str = "welding.urp") -> None:
        """Somebody starts another program at the pendant."""
        self._call("foreign_program", name=name)

    def power_off(self) -> None:
        """The arm's power is switched off at the pendant."""
        self._call("power_off")

    def table(self, z_m: float | None) -> None:
        """A safety plane that the flange must not come below; None for none."""
        self._call("table", z_m=z_m)

    def clear(self) -> None:
        """End the injected faults: links, planned stops, the pressed button, and local control.

        Their consequences stay. A protective stop must be unlocked, an arm without power must be powered on, and a
        foreign program continues.
        """
        self._call("clear")

    def reset(self, q_rad: Sequence[float] | NDArray[np.float64] | None = None) -> None:
        """`clear`, and a person puts everything right at the pendant: power, safety, no program; arm at `q_rad`."""
        self._call("reset", q_rad=None if q_rad is None else [float(q) for q in q_rad])

    def close(self) -> None:
        """Ends the connection; the next call makes a new one."""
        with self._turn:
            self._close()

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket, self._rest = None, b""

    def _call(self, call: str, /, **arguments: Any) -> Any:
        with self._turn:
            try:
                answer = self._exchange(json.dumps({"call": call, "arguments": arguments}).encode() + b"\n")
            except OSError as error:
                self._close()
                raise ControllerGoneError(f"no virtual controller answers at {self.host}: {error}") from error
        if "error" in answer:
            raise AdminRefusedError(answer["error"])
        return answer["answer"]

    def _exchange(self, line: bytes) -> dict[str, Any]:
        if self._socket is None:
            self._socket = socket.create_connection((self.host, ADMIN_PORT), timeout=self._timeout_s)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.sendall(line)
        parts = [self._rest]
        while b"\n" not in parts[-1]:
            part = self._socket.recv(1 << 16)
            if not part:
                raise ConnectionResetError("the connection was closed")
            parts.append(part)
        answer, self._rest = b"".join(parts).split(b"\n", 1)
        return json.loads(answer)
