"""`pointchain serve`: the HTTP service in front of a socket."""

import os
import signal
import socket
import sys

from service.app import create_app
from service.config import ServiceConfig
from service.data_folder import DataFolder, DataFolderError
from service.observing.json_log import start_log
from service.open_files import raise_open_files
from service.security.binding import check_binding
from service.server import Server
from service.supervision.supervised import Supervised

SWITCH_S = 0.001
"""A thread that waits for the interpreter gets it after so long. With Python's own 5 ms, whoever moves the arm waits
too long for its turns when many clients ask: its controller then ends the motion."""


def serve(config: ServiceConfig, line: int | None = None) -> int:
    """Serves until SIGINT or SIGTERM; 0 when it ended in order, 1 when it could not start.

    `line`: number of the socket to a supervisor; when that ends, the service does too.
    """
    binding = check_binding(config.host, config.data_dir, config.security.allowed_hosts)
    if binding.refusal is not None:
        print(f"pointchain serve: {binding.refusal}", file=sys.stderr)
        return 1
    if binding.note is not None:
        print(f"pointchain serve: {binding.note}", file=sys.stderr)
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
    start_log(config.log.format, config.log.level)
    raise_open_files()
    supervised = None if line is None else Supervised(line)
    if supervised is not None:
        supervised.when_it_ends(lambda: os.kill(os.getpid(), signal.SIGTERM))
    sys.setswitchinterval(SWITCH_S)
    server = Server(create_app(config), supervised, log_config=None, access_log=False)
    with listening:
        server.run(sockets=[listening])
    return 0 if server.started else 1


def _listen(host: str, port: int) -> socket.socket:
    """Taken before the service starts, so that a port in use is told in plain words, and 0 has become a port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.create_server((host, port), family=family)
    # asyncio sets this only where it makes the socket itself; without it every answer would wait 40 ms for the client's
    # delayed acknowledgement, since head and body are sent one after the other.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening
