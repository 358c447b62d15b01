"""The service's end of the line to its supervisor: signs of life go out, and its end comes in."""

import asyncio
import logging
import select
import socket
import threading
from collections.abc import Callable

log = logging.getLogger(__name__)

BEAT_S = 0.5


class Supervised:
    """One line, made from the number of its socket."""

    def __init__(self, number: int) -> None:
        self._line = socket.socket(fileno=number)
        self._line.setblocking(False)  # a supervisor that does not read must not make the loop wait
        self._line.set_inheritable(False)

    def listening(self, port: int) -> None:
        """Tells where the service listens; it counts as started then."""
        self._say(f"listening {port}\n")

    async def beat(self) -> None:
        """Tells again and again that the event loop turns."""
        while True:
            self._say("beat\n")
            await asyncio.sleep(BEAT_S)

    def when_it_ends(self, then: Callable[[], None]) -> None:
        """Calls `then`, in another thread, once the supervisor is gone."""

        def watch() -> None:
            try:
                select.select([self._line], [], [])  # it never says anything
            except (OSError, ValueError):
                log.exception("the line to the supervisor cannot be watched")
                return
            log.warning("the supervisor is gone: the service ends")
            then()

        threading.Thread(target=watch, name="supervisor-watch", daemon=True).start()

    def _say(self, words: str) -> None:
        try:
            self._line.sendall(words.encode())
        except BlockingIOError:
            log.debug("the supervisor does not read")
        except OSError:
            log.debug("there is no supervisor any more")
