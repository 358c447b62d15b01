"""The server: uvicorn, and how it ends."""

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
from service.server.heartbeat import Supervised

log = logging.getLogger(__name__)

KEEP_ALIVE_S = 75
"""How long an idle connection stays open: a client that asks every few seconds must not meet one that is just being
closed, as with uvicorn's own 5 s."""
ENDING_S = 3
"""Requests under way may take so long to end ..."""
CLIENTS_S = 2.5
"""... and clients so long to send the rest of theirs, or to take the rest of an answer."""
STREAMS_S = 1.5
"""Event streams stay open behind a signal until they have told how the scan under way has ended, at most so long."""
LAST_WORDS_S = 0.3
"""Who has taken nothing for so long when the streams end is not waited for."""
STALLED_S = 30.0
"""A client that takes nothing of what is sent, or whose machine is gone, is dropped after so long."""


class Server(uvicorn.Server):
    """Ends the scan under way, the arm first, as soon as a signal comes: uvicorn itself waits for requests before."""

    def __init__(self, app: FastAPI, supervised: Supervised | None = None, **options: Any) -> None:
        """`supervised`: the line to a supervisor, if there is one; `options`: more of uvicorn's."""
        limits = {
            "timeout_graceful_shutdown": ENDING_S,
            "timeout_keep_alive": KEEP_ALIVE_S,
            "backlog": backlog(),
        }
        super().__init__(uvicorn.Config(app, **limits, **(PROTOCOL | options)))
        self._app = app
        self._supervised = supervised
        self._beat: asyncio.Task[None] | None = None
        self._winding_up = False
        self._wound_up = threading.Event()
        """The scan under way has ended, and its row is written."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """The process ends by itself, with exit status 0: uvicorn would raise the signal again when all is done."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        loop = asyncio.get_running_loop()
        for number in HANDLED_SIGNALS:
            # Only so that the loop is woken also when the system hands the signal to another thread ...
            loop.add_signal_handler(number, lambda: None)
            # ... for this one, which is called between any two lines, is called in the loop's thread only.
            signal.signal(number, self.handle_exit)
        try:
            yield
        finally:
            for number in HANDLED_SIGNALS:
                loop.remove_signal_handler(number)
                signal.signal(number, signal.SIG_IGN)  # it has nothing left to do but to end

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Called in the event loop's thread, between any two lines: whatever waits is for another one.

        Not uvicorn's own: by that, a second Ctrl-C would leave out the end of the application.
        """
        self.should_exit = True
        self._wind_up()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listens; connections have the listening socket's options."""
        await super().startup(sockets)
        for listening in (one for server in self.servers for one in server.sockets):
            if hasattr(socket, "TCP_USER_TIMEOUT"):  # on Linux
                listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(STALLED_S * 1000))
        if self._supervised is not None and self.started:
            self._supervised.listening(self.servers[0].sockets[0].getsockname()[1])
            self._beat = asyncio.create_task(self._supervised.beat())  # as long as the loop turns

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Ends event streams, which never would by themselves, then requests, then the application."""
        if not self._winding_up:
            self._wind_up()
        clients = asyncio.create_task(self._end_clients())
        await super().shutdown(sockets)
        clients.cancel()

    def _wind_up(self) -> None:
        context: Context | None = getattr(self._app.state, "context", None)
        if context is None:
            return
        self._winding_up = True

        def wind_up() -> None:
            try:
                context.jobs.wind_up()
            except Exception:  # in a thread that nobody waits for; closing the application tries it again
                log.exception("what is under way could not be ended")
            finally:
                self._wound_up.set()

        threading.Thread(target=wind_up, name="winding-up", daemon=True).start()

    async def _end_clients(self) -> None:
        context: Context | None = getattr(self._app.state, "context", None)
        begin, connections = time.monotonic(), self.server_state.connections
        if context is not None:
            while not self._wound_up.is_set() and time.monotonic() < begin + STREAMS_S:
                await asyncio.sleep(0.02)
            context.store.events.hub.close()
        unsent = {connection: _unsent(connection) for connection in connections}
        await asyncio.sleep(LAST_WORDS_S)
        _abort(one for one in connections if 0 < unsent.get(one, 0) <= _unsent(one))
        await asyncio.sleep(begin + CLIENTS_S - time.monotonic())
        _abort(connections)


def _abort(connections: Iterable[object]) -> None:
    """To close them would be to wait until all is sent."""
    for connection in list(connections):
        if isinstance(connection, H11Protocol):
            connection.transport.abort()


def _unsent(connection: object) -> int:
    return connection.transport.get_write_buffer_size() if isinstance(connection, H11Protocol) else 0
