"""The service's end of the socket to its supervisor: it sends heartbeats, and notices the supervisor's exit."""

import asyncio
import logging
import select
import socket
import threading
from collections.abc import Callable

log = logging.getLogger(__name__)

HEARTBEAT_INTERVAL_S = 0.5


class SupervisorLink:
    """The socket to the supervisor, opened by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self._socket = socket.socket(fileno=descriptor)
        self._socket.setblocking(False)  # a supervisor that does not read must not block the event loop
        self._socket.set_inheritable(False)

    def report_listening(self, port: int) -> None:
        """Report the port on which the service listens. For the supervisor, the service has then started."""
        self._send(f"listening {port}\n")

    async def send_heartbeats(self) -> None:
        """Send a heartbeat every `HEARTBEAT_INTERVAL_S`, for as long as the event loop runs."""
        while True:
            self._send("beat\n")
            await asyncio.sleep(HEARTBEAT_INTERVAL_S)

    def on_supervisor_exit(self, callback: Callable[[], None]) -> None:
        """Call `callback` in another thread when the supervisor has ended."""

        def watch() -> None:
            try:
                select.select([self._socket], [], [])  # the supervisor never sends: the socket is readable at its end
            except (OSError, ValueError):
                log.exception("the socket to the supervisor cannot be watched")
                return
            log.warning("the supervisor has ended, so the service ends")
            callback()

        threading.Thread(target=watch, name="supervisor-watch", daemon=True).start()

    def _send(self, message: str) -> None:
        try:
            self._socket.sendall(message.encode())
        except BlockingIOError:
            log.debug("the supervisor does not read its socket")
        except OSError:
            log.debug("the supervisor has ended")
