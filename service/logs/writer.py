"""A log handler with its own writer thread.

A program that stops reading the service's stderr blocks every write to it. The event loop, and the thread that stops
the arm, must not block.
"""

import logging
import queue
import threading
from typing import TextIO

MAX_QUEUED_LINES = 10_000
"""Maximum number of lines in the queue. Further lines are dropped and counted."""
BATCH_LINES = 100
"""Maximum number of lines per write."""
BATCH_INTERVAL_S = 0.02
"""Pause after each write. At a thousand requests per second, a thread that woke for each line would slow them down."""
CLOSE_TIMEOUT_S = 1.0
"""Timeout for writing the queued lines when the handler is closed."""


class LogWriter(logging.Handler):
    """Formats a record in the thread that logs it, and writes it in another. Logging never blocks and never fails."""

    def __init__(self, stream: TextIO, max_lines: int = MAX_QUEUED_LINES) -> None:
        super().__init__()
        self._stream = stream
        self._lines: queue.Queue[str | None] = queue.Queue(max_lines)
        self._dropped = 0
        """Approximate number of dropped lines, because two threads change it without a lock."""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        self._thread.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record, or drop it if the queue is full."""
        try:
            self._lines.put_nowait(self.format(record))
        except queue.Full:
            self._dropped += 1
        except Exception:  # noqa: BLE001 (as in every handler: a record that cannot be formatted must not raise)
            self.handleError(record)

    def close(self) -> None:
        """Write the queued lines, for `CLOSE_TIMEOUT_S` at most. Later records are not written."""
        if not self._closed.is_set():
            self._closed.set()
            try:
                self._lines.put(None, timeout=CLOSE_TIMEOUT_S)
                self._thread.join(CLOSE_TIMEOUT_S)
            except queue.Full:  # the stream is not read, so waiting longer would not help
                pass
        super().close()

    def _write(self) -> None:
        ending = False
        while not ending:
            lines = [self._lines.get()]
            while not self._lines.empty() and len(lines) < BATCH_LINES:
                lines.append(self._lines.get())
            ending = None in lines
            dropped, self._dropped = self._dropped, 0
            if dropped:
                lost = logging.LogRecord(__name__, logging.WARNING, "", 0, "%d lines lost", (dropped,), None)
                lines.insert(0, self.format(lost))
            try:
                self._stream.write("".join(f"{line}\n" for line in lines if line is not None))
                self._stream.flush()
                self._closed.wait(BATCH_INTERVAL_S)
            except (OSError, ValueError):  # the reader is gone or the stream is closed: nothing can be reported
                self._dropped += 1
