"""`pointchain serve`: the HTTP service in front of a socket."""

import socket
import sys
import threading
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.config import ServiceConfig
from service.context import Context
from service.data_folder import DataFolder, DataFolderError

KEEP_ALIVE_S = 75
"""How long an idle connection stays open: a client that asks every few seconds must not meet one that is just being
closed, as with uvicorn's own 5 s."""


ENDING_S = 5
"""Requests under way may take so long to end."""


class Server(uvicorn.Server):
    """Ends the scan under way, the arm first, as soon as a signal comes: uvicorn itself waits for requests before."""

    def __init__(self, app: FastAPI, **options: Any) -> None:
        """`options`: more of uvicorn's."""
        limits = {"timeout_graceful_shutdown": ENDING_S, "timeout_keep_alive": KEEP_ALIVE_S}
        super().__init__(uvicorn.Config(app, **limits, **options))
        self._app = app

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Called in the event loop's thread, between any two lines: whatever waits is for another one."""
        super().handle_exit(sig, frame)
        context: Context | None = getattr(self._app.state, "context", None)
        if context is not None:
            threading.Thread(target=context.jobs.wind_up, name="winding-up", daemon=True).start()


def serve(config: ServiceConfig) -> int:
    """Serves until SIGINT or SIGTERM; 0 when it ended in order, 1 when it could not start."""
    try:
        # Taken for a moment: inside the server the same refusal would come as a traceback.
        DataFolder(config.data_dir).close()
    except DataFolderError as error:
        print(f"pointchain serve: {error}", file=sys.stderr)
        return 1
    try:
        listening = _listen(config.host, config.port)
    except OSError as error:
        where = f"{config.host}:{config.port}"
        print(f"pointchain serve: cannot listen on {where}: {error.strerror or error}", file=sys.stderr)
        return 1
    address = f"[{config.host}]" if ":" in config.host else config.host
    print(f"pointchain: http://{address}:{listening.getsockname()[1]}/docs, data in {config.data_dir}", file=sys.stderr)
    server = Server(create_app(config))
    with listening:
        server.run(sockets=[listening])
    return 0 if server.started else 1


def _listen(host: str, port: int) -> socket.socket:
    """Taken before the service starts, so that a port in use is told in plain words, and 0 has become a port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family)
