"""Client of the administration port of the virtual controller: state, log, and fault injection.

It is used by tests, and by the simulated camera for the flange pose. The protocol is lines of JSON.
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
    """The controller rejects a request."""


@dataclass(frozen=True, eq=False)
class ControllerState:
    """State of the virtual robot at one moment."""

    stamp_s: float
    """Time, seconds of `time.monotonic()`, which all processes of a Linux machine share."""
    q_rad: NDArray[np.float64]
    """Joint angles (6,)."""
    qd_rad_s: NDArray[np.float64]
    """Joint speeds (6,) by the wall clock, including the time factor."""
    T_base_flange: NDArray[np.float64]
    """(4, 4) actual flange pose."""
    robot_mode: str
    """Robot mode, for example "RUNNING"."""
    safety_mode: str
    """Safety mode, for example "NORMAL" or "PROTECTIVE_STOP"."""
    program_state: str
    """State of the program, for example "PLAYING", "PAUSED" or "STOPPED"."""
    program: str | None
    """Name of the program, or None."""
    moving: bool
    progress: float
    """Completed share of the current move, 0 to 1."""
    watchdog_hz: float
    """Frequency of the watchdog, or 0 while it is off."""
    watchdog_kicked_s: float
    """Time of the last signal to the watchdog, on the clock of `stamp_s`."""
    watchdog_kicks: int
    """Number of signals to the watchdog since it was started."""
    remote: bool
    speed_fraction: float
    events: int
    """Number of events so far. `log(since=events)` returns later ones."""
    connections: dict[str, int]
    """Number of connections of each port, by "rtde", "script" and "dashboard"."""


class AdminClient:
    """Client of the virtual controller at an address.

    It connects at the first call and may be used from several threads.
    """

    def __init__(self, host: str, timeout_s: float = 5.0) -> None:
        self.host = host
        self._timeout_s = timeout_s
        self._turn = threading.Lock()
        self._socket: socket.socket | None = None
        self._rest = b""

    def state(self) -> ControllerState:
        """Return the present state. Raise ControllerGoneError without a controller."""
        answer = self._call("state")
        for name in ("q_rad", "qd_rad_s", "T_base_flange"):
            answer[name] = np.array(answer[name])
        return ControllerState(**answer)

    def pose(self) -> NDArray[np.float64]:
        """Return the true flange pose (4, 4) at this time. Raise ControllerGoneError without a controller."""
        return np.array(self._call("pose")["T_base_flange"])

    def log(self, since: int = 0) -> list[dict[str, Any]]:
        """Return the events from number `since` on, each with index, stamp_s (`time.monotonic()`), kind and details.

        The oldest of many events are dropped.
        """
        return self._call("log", since=since)

    def drop(self) -> None:
        """Reset all RTDE connections once."""
        self._call("drop")

    def freeze(self) -> None:
        """Let RTDE be silent in both directions with open sockets, until `clear`."""
        self._call("freeze")

    def half_open(self) -> None:
        """Accept new connections without ever answering, until `clear`."""
        self._call("half_open")

    def unreachable(self) -> None:
        """Reset all connections and refuse new ones, until `clear`."""
        self._call("unreachable")

    def slow(self, delay_s: float = 0.0, rate_hz: float | None = None) -> None:
        """Delay RTDE packages, or send them at a lower rate, until `clear`."""
        self._call("slow", delay_s=delay_s, rate_hz=rate_hz)

    def protective_stop(self, after_s: float = 0.0, at_share: float | None = None) -> None:
        """Stop the arm by the safety system now, after a time, or at a share of the current or next move."""
        self._call("protective_stop", after_s=after_s, at_share=at_share)

    def emergency_stop(self) -> None:
        """Press the emergency stop button, until `clear`."""
        self._call("emergency_stop")

    def local_mode(self) -> None:
        """Switch to local control at the pendant, until `clear`."""
        self._call("local_mode")

    def foreign_program(self, name: str = "welding.urp") -> None:
        """Start another program at the pendant."""
        self._call("foreign_program", name=name)

    def power_off(self) -> None:
        """Switch off the arm's power at the pendant."""
        self._call("power_off")

    def table(self, z_m: float | None) -> None:
        """Set a safety plane below which the flange must not go, or None for no plane."""
        self._call("table", z_m=z_m)

    def clear(self) -> None:
        """End the injected faults: links, planned stops, the pressed button, and local control.

        Their consequences stay. A protective stop must be unlocked, an arm without power must be powered on, and a
        foreign program continues.
        """
        self._call("clear")

    def reset(self, q_rad: Sequence[float] | NDArray[np.float64] | None = None) -> None:
        """Call `clear`, and restore power, safety and program state at the pendant, with the arm at `q_rad`."""
        self._call("reset", q_rad=None if q_rad is None else [float(q) for q in q_rad])

    def close(self) -> None:
        """Close the connection. The next call opens a new one."""
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
