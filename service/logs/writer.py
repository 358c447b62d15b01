"""Lines of the log on their way to a stream, written by a thread of its own.

Whoever reads the service's stderr may have stopped reading. The event loop, and the thread that stops the arm, must not
wait for him.
"""

import logging
import queue
import threading
from typing import TextIO

MOST_LINES = 10_000
"""So many may wait; more are dropped, and counted."""
AT_ONCE = 100
"""So many lines are written together, ..."""
GATHER_S = 0.02
"""... and they gather for so long: with a thousand requests a second, a thread that woke for each would be in their
way."""
END_S = 1.0
"""At the end, lines that wait are written for so long."""


class LogWriter(logging.Handler):
    """Formats in the thread that logs, and writes in its own. Logging never waits, and never fails."""

    def __init__(self, stream: TextIO, most_lines: int = MOST_LINES) -> None:
        super().__init__()
        self._stream = stream
        self._lines: queue.Queue[str | None] = queue.Queue(most_lines)
        self._dropped = 0
        """About: two threads count."""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Takes a record; drops it when too many wait."""
        try:
            self._lines.put_nowait(self.format(record))
        except queue.Full:
            self._dropped += 1
        except Exception:  # noqa: BLE001 (as every handler does: a record that cannot be formatted harms nobody)
            self.handleError(record)

    def close(self) -> None:
        """Writes what waits, for some time; later records are not written."""
        if not self._closed.is_set():
            self._closed.set()
            try:
                self._lines.put(None, timeout=END_S)
                self._thread.join(END_S)
            except queue.Full:  # nobody reads: so nobody would read this either
                pass
        super().close()

    def _write(self) -> None:
        ending = False
        while not ending:
            lines = [self._lines.get()]
            while not self._lines.empty() and len(lines) < AT_ONCE:
                lines.append(self._lines.get())
            ending = None in lines
            dropped, self._dropped = self._dropped, 0
            if dropped:
                lost = logging.LogRecord(__name__, logging.WARNING, "", 0, "%d lines lost", (dropped,), None)
                lines.insert(0, self.format(lost))
            try:
                self._stream.write("".join(f"{line}\n" for line in lines if line is not None))
                self._stream.flush()
                self._closed.wait(GATHER_S)
            except (OSError, ValueError):  # the reader is gone, or the stream closed: there is nowhere to say so
                self._dropped += 1
