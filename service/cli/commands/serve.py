"""`pointchain serve`: the HTTP service in front of a socket."""

import errno
import logging
import os
import signal
import socket
import sys
from pathlib import Path

from service.app import create_app
from service.config.loader import ServiceConfig
from service.logs.setup import start_log
from service.security.auth.allowed_hosts import called_by
from service.security.auth.bind_policy import check_binding
from service.server.file_limit import raise_open_files
from service.server.heartbeat import Supervised
from service.server.uvicorn_server import Server
from service.storage.data_folder import DataFolder, DataFolderError

log = logging.getLogger(__name__)

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
        print(f"pointchain serve: cannot listen on {where}: {error.strerror or error}{_remedy(error)}", file=sys.stderr)
        return 1
    as_log = start_log(config.log.format, config.log.level) == "json"
    if binding.note is not None:
        _tell(f"pointchain serve: {binding.note}", as_log)
    _tell(_where(config.host, listening.getsockname()[1], config.data_dir), as_log)
    raise_open_files()
    supervised = None if line is None else Supervised(line)
    if supervised is not None:
        supervised.when_it_ends(lambda: os.kill(os.getpid(), signal.SIGTERM))
    sys.setswitchinterval(SWITCH_S)
    server = Server(create_app(config), supervised, log_config=None, access_log=False)
    with listening:
        server.run(sockets=[listening])
    return 0 if server.started else 1


def _tell(words: str, as_log: bool) -> None:
    """Where the log is for programs, everything on stderr is its; whatever its level, as on a terminal."""
    if as_log:
        log.setLevel(logging.INFO)
        log.info("%s", words)
    else:
        print(words, file=sys.stderr)


def _where(host: str, port: int, data_dir: Path) -> str:
    name = called_by(host)
    return f"pointchain: http://{f'[{name}]' if ':' in name else name}:{port} (API: /docs), data in {data_dir}"


def _remedy(error: OSError) -> str:
    """What to do where another program has the port."""
    if error.errno != errno.EADDRINUSE:
        return ""
    return ": end what listens there, or take another port, as by --port 8001 or POINTCHAIN_PORT=8001"


def _listen(host: str, port: int) -> socket.socket:
    """Taken before the service starts, so that a port in use is told in plain words, and 0 has become a port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.create_server((host, port), family=family)
    # asyncio sets this only where it makes the socket itself; without it every answer would wait 40 ms for the client's
    # delayed acknowledgement, since head and body are sent one after the other.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening
