"""`pointchain serve`: the HTTP service in front of a socket."""

import socket
import sys

import uvicorn

from service.app import create_app
from service.config import ServiceConfig
from service.data_folder import DataFolder, DataFolderError

KEEP_ALIVE_S = 75
"""How long an idle connection stays open: a client that asks every few seconds must not meet one that is just being
closed, as with uvicorn's own 5 s."""


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
    server = uvicorn.Server(
        uvicorn.Config(
            create_app(config),
            timeout_graceful_shutdown=5,
            timeout_keep_alive=KEEP_ALIVE_S,
        )
    )
    with listening:
        server.run(sockets=[listening])
    return 0 if server.started else 1


def _listen(host: str, port: int) -> socket.socket:
    """Taken before the service starts, so that a port in use is told in plain words, and 0 has become a port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family)
