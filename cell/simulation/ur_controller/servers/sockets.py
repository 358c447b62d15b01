"""The controller's listening sockets, and what can be wrong with its network link."""

import asyncio
import contextlib
import socket
import struct
from dataclasses import dataclass, field

ADMIN_PORT = 29900
"""Ours; no real controller has it."""
DASHBOARD_PORT, SCRIPT_PORT, RTDE_PORT = 29999, 30003, 30004
PORTS = (ADMIN_PORT, DASHBOARD_PORT, SCRIPT_PORT, RTDE_PORT)


def listening(host: str) -> dict[int, socket.socket]:
    """Sockets that listen on all the controller's ports of the address: all of them, or OSError."""
    sockets: dict[int, socket.socket] = {}
    try:
        # The admin port goes first: whoever listens on it has the address, the others need not try.
        for port in PORTS:
            sockets[port] = bound(host, port)
            sockets[port].listen(100)
    except OSError:
        for each in sockets.values():
            each.close()
        raise
    return sockets


def bound(host: str, port: int) -> socket.socket:
    """A socket that holds the port but refuses connections until it listens."""
    new = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    new.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        new.bind((host, port))
    except OSError:
        new.close()
        raise
    new.setblocking(False)
    return new


@dataclass
class Links:
    """What is wrong with the link, and who is connected."""

    frozen: bool = False
    """Nothing of RTDE goes through either way; what clients send meanwhile arrives afterwards, as with a cable pulled
    and put back."""
    half_open: bool = False
    """New connections are accepted and never answered."""
    delay_s: float = 0.0
    """RTDE packages leave so much later."""
    rate_hz: float | None = None
    """RTDE packages leave at most so often."""
    transports: dict[asyncio.Transport, int] = field(default_factory=dict)
    """The connections and their ports."""
    mute: set[asyncio.Transport] = field(default_factory=set)
    """Those accepted while half open."""

    def opened(self, transport: asyncio.Transport, port: int) -> bool:
        """A connection came in. False if it is not to be answered."""
        sock: socket.socket = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transports[transport] = port
        if self.half_open:
            self.mute.add(transport)
        if self.half_open or (self.frozen and port == RTDE_PORT):
            # Not at once: early releases of Python 3.11 begin to read behind this, paused or not.
            asyncio.get_running_loop().call_soon(transport.pause_reading)
        return not self.half_open

    def closed(self, transport: asyncio.Transport) -> None:
        """A connection ended."""
        self.transports.pop(transport, None)
        self.mute.discard(transport)

    def reset(self, *ports: int) -> None:
        """Resets the connections of these ports."""
        for transport in [transport for transport, port in self.transports.items() if port in ports]:
            sock: socket.socket = transport.get_extra_info("socket")
            with contextlib.suppress(OSError):  # it has just gone by itself
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            transport.abort()

    def freeze(self, frozen: bool) -> None:
        """Stops or lets go on all RTDE traffic."""
        self.frozen = frozen
        for transport, port in self.transports.items():
            if port == RTDE_PORT and transport not in self.mute and not transport.is_closing():
                transport.pause_reading() if frozen else transport.resume_reading()

    def answer_again(self) -> None:
        """Ends half-open; the connections of that time are reset."""
        self.half_open = False
        for transport in list(self.mute):
            transport.abort()

    def clear(self) -> None:
        """Nothing is wrong any more."""
        self.answer_again()
        self.freeze(False)
        self.delay_s, self.rate_hz = 0.0, None
