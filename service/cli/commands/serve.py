"""`pointchain serve`: run the HTTP service on a TCP socket."""

import errno
import logging
import os
import signal
import socket
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

from service.app import create_app
from service.config.loader import ServiceConfig
from service.logs.setup import configure_logging
from service.security.auth.allowed_hosts import local_address
from service.security.auth.bind_policy import check_binding
from service.server.file_limit import raise_file_limit
from service.server.heap import share_one_heap
from service.server.supervisor_link import SupervisorLink
from service.server.uvicorn_server import Server
from service.storage.data_folder import DataFolder, DataFolderError
from service.storage.database import Database, StoreVersionError
from service.storage.storage_errors import is_full, is_locked

log = logging.getLogger(__name__)

SWITCH_INTERVAL_S = 0.001
"""Switch interval of Python's threads. With the default 5 ms, the thread that moves the arm waits too long when many
clients send requests, and the controller ends the motion."""


def serve(config: ServiceConfig, supervisor_fd: int | None = None) -> int:
    """Serve until SIGINT or SIGTERM.

    Args:
        config: The configuration.
        supervisor_fd: File descriptor of the socket to the supervisor. When the supervisor ends, the service ends too.
            None: no supervisor.

    Returns:
        The exit code: 0 after an orderly end, 1 if the service could not start.
    """
    share_one_heap()  # before any thread has a heap
    binding = check_binding(config.host, config.data_dir, config.security.allowed_hosts)
    if binding.refusal is not None:
        print(f"pointchain serve: {binding.refusal}", file=sys.stderr)
        return 1
    try:
        # opened and closed here, because inside the server the same error would be a traceback
        with closing(DataFolder(config.data_dir)) as folder:
            Database(folder.database).close()
    except (DataFolderError, StoreVersionError) as error:
        print(f"pointchain serve: {error}", file=sys.stderr)
        return 1
    except sqlite3.Error as error:
        print(f"pointchain serve: {_why_unusable(error, config.data_dir)}", file=sys.stderr)
        return 1
    try:
        listening = _listen(config.host, config.port)
    except OSError as error:
        where = f"{config.host}:{config.port}"
        print(f"pointchain serve: cannot listen on {where}: {error.strerror or error}{_advice(error)}", file=sys.stderr)
        return 1
    as_log = configure_logging(config.log.format, config.log.level) == "json"
    if binding.note is not None:
        _announce(f"pointchain serve: {binding.note}", as_log)
    _announce(_address_line(config.host, listening.getsockname()[1], config.data_dir), as_log)
    raise_file_limit()
    supervised = None if supervisor_fd is None else SupervisorLink(supervisor_fd)
    if supervised is not None:
        supervised.on_supervisor_exit(lambda: os.kill(os.getpid(), signal.SIGTERM))
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    server = Server(create_app(config), supervised, log_config=None, access_log=False)
    with listening:
        server.run(sockets=[listening])
    return 0 if server.started else 1


def _why_unusable(error: sqlite3.Error, data_dir: Path) -> str:
    """Return why the database cannot be used, and what to do."""
    if is_full(error):
        return f"{data_dir}: no space is left for the database, which this release must make or change: free some"
    if is_locked(error):
        return f"{data_dir}: another program has locked the database: end it, and start again"
    return f"{data_dir}: the database cannot be used: {error}; run `pointchain doctor`"


def _announce(message: str, as_log: bool) -> None:
    """Print a message to stderr, or log it at any log level if stderr has JSON lines only."""
    if as_log:
        log.setLevel(logging.INFO)
        log.info("%s", message)
    else:
        print(message, file=sys.stderr)


def _address_line(host: str, port: int, data_dir: Path) -> str:
    name = local_address(host)
    return f"pointchain: http://{f'[{name}]' if ':' in name else name}:{port} (API: /docs), data in {data_dir}"


def _advice(error: OSError) -> str:
    """Return what to do if another program uses the port."""
    if error.errno != errno.EADDRINUSE:
        return ""
    return ": stop the program that listens there, or use another port, as by --port 8001 or POINTCHAIN_PORT=8001"


def _listen(host: str, port: int) -> socket.socket:
    """Open the socket, before the service starts: a used port gives a plain message, and port 0 becomes a number."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.create_server((host, port), family=family)
    # asyncio sets this only on sockets that it creates; without it every response, whose head and body are sent one
    # after the other, would wait 40 ms for the client's delayed acknowledgement
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening
