"""Listening sockets of the virtual controller, and faults of its network link."""

import asyncio
import contextlib
import socket
import struct
from dataclasses import dataclass, field

ADMIN_PORT = 29900
"""Port of the admin server; a real controller has none."""
DASHBOARD_PORT, SCRIPT_PORT, RTDE_PORT = 29999, 30003, 30004
PORTS = (ADMIN_PORT, DASHBOARD_PORT, SCRIPT_PORT, RTDE_PORT)


def listening(host: str) -> dict[int, socket.socket]:
    """Return sockets that listen on all ports of the controller. Raise OSError if a port is in use."""
    sockets: dict[int, socket.socket] = {}
    try:
        # The admin port is bound first, so that it decides which controller owns the address.
        for port in PORTS:
            sockets[port] = bound(host, port)
            sockets[port].listen(100)
    except OSError:
        for each in sockets.values():
            each.close()
        raise
    return sockets


def bound(host: str, port: int) -> socket.socket:
    """Return a socket that is bound to the port. It refuses connections until it listens."""
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
    """Network link of the controller: connections and injected faults."""

    frozen: bool = False
    """Hold back RTDE traffic in both directions. Packages of clients arrive later, as after a pulled cable."""
    half_open: bool = False
    """Accept new connections without answering them."""
    delay_s: float = 0.0
    """Delay of RTDE packages, seconds."""
    rate_hz: float | None = None
    """Largest rate of RTDE packages, or None for no limit."""
    transports: dict[asyncio.Transport, int] = field(default_factory=dict)
    """Ports of the open connections."""
    mute: set[asyncio.Transport] = field(default_factory=set)
    """Connections accepted while half open."""

    def opened(self, transport: asyncio.Transport, port: int) -> bool:
        """Register a connection. Return whether it is to be answered."""
        sock: socket.socket = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transports[transport] = port
        if self.half_open:
            self.mute.add(transport)
        if self.half_open or (self.frozen and port == RTDE_PORT):
            # Deferred: early releases of Python 3.11 start reading after this call, paused or not.
            asyncio.get_running_loop().call_soon(transport.pause_reading)
        return not self.half_open

    def closed(self, transport: asyncio.Transport) -> None:
        """Unregister a connection."""
        self.transports.pop(transport, None)
        self.mute.discard(transport)

    def reset(self, *ports: int) -> None:
        """Reset the connections of the given ports."""
        for transport in [transport for transport, port in self.transports.items() if port in ports]:
            sock: socket.socket = transport.get_extra_info("socket")
            with contextlib.suppress(OSError):  # the peer has just closed it
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            transport.abort()

    def freeze(self, frozen: bool) -> None:
        """Hold back (True) or resume (False) all RTDE traffic."""
        self.frozen = frozen
        for transport, port in self.transports.items():
            if port == RTDE_PORT and transport not in self.mute and not transport.is_closing():
                transport.pause_reading() if frozen else transport.resume_reading()

    def answer_again(self) -> None:
        """End the half-open fault and reset the connections accepted meanwhile."""
        self.half_open = False
        for transport in list(self.mute):
            transport.abort()

    def clear(self) -> None:
        """End all faults of the link."""
        self.answer_again()
        self.freeze(False)
        self.delay_s, self.rate_hz = 0.0, None
