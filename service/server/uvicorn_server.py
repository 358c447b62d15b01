"""The uvicorn server and its shutdown: first the arm stops, then event streams, requests and the application end."""

import asyncio
import logging
import signal
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import HANDLED_SIGNALS

from service.api.dependencies import Context
from service.server.connections import PROTOCOL, backlog
from service.server.supervisor_link import SupervisorLink

log = logging.getLogger(__name__)

KEEP_ALIVE_S = 75
"""Time for which an idle connection stays open.

With uvicorn's default of 5 s, a client that polls every few seconds could use a connection that is just being closed.
"""
GRACEFUL_SHUTDOWN_S = 3
"""Timeout for running requests to end at the shutdown."""
CLIENT_SHUTDOWN_S = 2.5
"""Timeout at the shutdown for clients to send the rest of their requests and to receive the rest of their answers."""
STREAM_SHUTDOWN_S = 1.5
"""Maximum time for which event streams stay open after a signal, so that they report the end of the running scan."""
STALLED_CHECK_S = 0.3
"""A client that receives nothing for this time, when the event streams end, is disconnected."""
STALLED_S = 30.0
"""Time after which a client is disconnected that receives nothing of what is sent, or whose machine is gone."""


class Server(uvicorn.Server):
    """Stops the arm and ends the running scan as soon as a signal arrives. uvicorn alone would wait for requests."""

    def __init__(self, app: FastAPI, supervisor: SupervisorLink | None = None, **options: Any) -> None:
        """Create the server.

        Args:
            app: The application.
            supervisor: Socket to the supervisor. None: there is no supervisor.
            options: Further options of uvicorn.
        """
        limits = {
            "timeout_graceful_shutdown": GRACEFUL_SHUTDOWN_S,
            "timeout_keep_alive": KEEP_ALIVE_S,
            "backlog": backlog(),
        }
        super().__init__(uvicorn.Config(app, **limits, **(PROTOCOL | options)))
        self._app = app
        self._supervisor = supervisor
        self._heartbeats: asyncio.Task[None] | None = None
        self._draining = False
        self._drained = threading.Event()
        """Set when the running scan has ended and its row is written."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Handle signals so that the exit status is 0; uvicorn alone would raise the signal again at the end."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        loop = asyncio.get_running_loop()
        for number in HANDLED_SIGNALS:
            # This handler only wakes the loop if the system delivers the signal to another thread.
            loop.add_signal_handler(number, lambda: None)
            # This one handles it. Python calls it in the loop's thread only, between any two lines.
            signal.signal(number, self.handle_exit)
        try:
            yield
        finally:
            for number in HANDLED_SIGNALS:
                loop.remove_signal_handler(number)
                signal.signal(number, signal.SIG_IGN)  # the process is about to end anyway

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Request the shutdown. It runs in the event loop's thread between any two lines, so it must not block.

        It replaces uvicorn's own handler, in which a second Ctrl-C would skip the shutdown of the application.
        """
        self.should_exit = True
        self._start_drain()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to listen, and report the port to the supervisor. Connections inherit the options of their socket."""
        await super().startup(sockets)
        for listening in (one for server in self.servers for one in server.sockets):
            if hasattr(socket, "TCP_USER_TIMEOUT"):  # on Linux
                listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(STALLED_S * 1000))
        if self._supervisor is not None and self.started:
            self._supervisor.report_listening(self.servers[0].sockets[0].getsockname()[1])
            self._heartbeats = asyncio.create_task(self._supervisor.send_heartbeats())

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the event streams, which never end by themselves, then the requests, then the application."""
        if not self._draining:
            self._start_drain()
        clients = asyncio.create_task(self._end_clients())
        await super().shutdown(sockets)
        clients.cancel()

    def _start_drain(self) -> None:
        context: Context | None = getattr(self._app.state, "context", None)
        if context is None:
            return
        self._draining = True

        def drain() -> None:
            try:
                context.jobs.drain()
            except Exception:  # nothing waits for this thread; closing the application tries it again
                log.exception("the running scan could not be ended; it is tried again when the application closes")
            finally:
                self._drained.set()

        threading.Thread(target=drain, name="shutdown-drain", daemon=True).start()

    async def _end_clients(self) -> None:
        context: Context | None = getattr(self._app.state, "context", None)
        begin, connections = time.monotonic(), self.server_state.connections
        if context is not None:
            while not self._drained.is_set() and time.monotonic() < begin + STREAM_SHUTDOWN_S:
                await asyncio.sleep(0.02)
            context.store.events.hub.close()
        unsent = {connection: _unsent_bytes(connection) for connection in connections}
        await asyncio.sleep(STALLED_CHECK_S)
        _abort(one for one in connections if 0 < unsent.get(one, 0) <= _unsent_bytes(one))
        await asyncio.sleep(begin + CLIENT_SHUTDOWN_S - time.monotonic())
        _abort(connections)


def _abort(connections: Iterable[object]) -> None:
    """Abort the connections; closing one would wait until everything is sent."""
    for connection in list(connections):
        if isinstance(connection, H11Protocol):
            connection.transport.abort()


def _unsent_bytes(connection: object) -> int:
    return connection.transport.get_write_buffer_size() if isinstance(connection, H11Protocol) else 0
