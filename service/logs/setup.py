"""The service's log on stderr: one JSON document a line for programs, or plain lines for people.

Whatever is logged while a scan is worked on has the scan's id, in its thread, its recognition process, and in the
requests about it. Tokens, query strings and bodies are never logged.
"""

import json
import logging
import multiprocessing
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from functools import partial
from typing import Any, Literal

from cell.process.logging import configure_child_logging
from service.clock import stamp
from service.logs.writer import LogWriter

Format = Literal["auto", "json", "text"]
Level = Literal["debug", "info", "warning", "error"]

TALKATIVE = ("matplotlib", "PIL")
"""Libraries whose debug lines tell nothing of the service."""
ENCODER = json.JSONEncoder(ensure_ascii=False, default=str)

_scan: ContextVar[str | None] = ContextVar("scan", default=None)
_request: ContextVar[str | None] = ContextVar("request", default=None)


@contextmanager
def log_scan(scan_id: str | None) -> Iterator[None]:
    """Whatever is logged in the body, and by what it has others do, is of this scan."""
    token = _scan.set(scan_id)
    try:
        yield
    finally:
        _scan.reset(token)


@contextmanager
def log_request(request_id: str) -> Iterator[None]:
    """The same for a request."""
    token = _request.set(request_id)
    try:
        yield
    finally:
        _request.reset(token)


class JsonFormatter(logging.Formatter):
    """A record as one line of JSON.

    `at` (RFC 3339, UTC), `level`, `logger`, `message`, `process`, `thread`; `scan`, `request` and `exception` where
    there is one; and the members of the record's `access`, if it has that.
    """

    def format(self, record: logging.LogRecord) -> str:
        """The line, without its end."""
        document: dict[str, Any] = {
            "at": stamp(_at(record)),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
            "process": record.processName,
            "thread": record.threadName,
        }
        if (scan := _scan.get()) is not None:
            document["scan"] = scan
        if (request := _request.get()) is not None:
            document["request"] = request
        document |= getattr(record, "access", {})
        if traceback := _traceback(self, record):
            document["exception"] = traceback
        return ENCODER.encode(document)


class TextFormatter(logging.Formatter):
    """A record for people: time, level, who, what; a traceback on lines of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """The lines, without the last one's end."""
        time = _at(record).astimezone().strftime("%H:%M:%S")
        line = f"{time} {record.levelname.lower():8}{record.name}: {record.getMessage()}"
        if (scan := _scan.get()) is not None and scan not in line:
            line += f" (scan {scan})"
        traceback = _traceback(self, record)
        return f"{line}\n{traceback}" if traceback else line


def start_log(form: Format, level: Level) -> Literal["json", "text"]:
    """From here on this process and the children that it starts write their log so, to stderr; `auto`: as text on a
    terminal. Which of the two it is. Replaces what was set up before; uvicorn's own loggers go the same way, but for
    its line a request."""
    if form == "auto":
        form = "text" if sys.stderr.isatty() else "json"
    _write_to(LogWriter(sys.stderr), form, level)
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = name != "uvicorn.access"
    logging.captureWarnings(True)
    threading.excepthook = _log_end_of_thread
    configure_child_logging(partial(start_child_log, form, level))
    return form


def start_child_log(form: Format, level: Level, name: str) -> None:
    """The same for a process that was started by such a one; `name` is the process's."""
    multiprocessing.current_process().name = name
    _write_to(logging.StreamHandler(sys.stderr), form, level)


def _write_to(handler: logging.Handler, form: Format, level: Level) -> None:
    handler.setFormatter(JsonFormatter() if form == "json" else TextFormatter())
    root = logging.getLogger()
    for former in root.handlers[:]:
        root.removeHandler(former)
        former.close()
    root.addHandler(handler)
    root.setLevel(level.upper())
    for name in TALKATIVE:
        logging.getLogger(name).setLevel(logging.WARNING)


def _log_end_of_thread(hook: threading.ExceptHookArgs) -> None:
    if hook.exc_value is None or issubclass(hook.exc_type, SystemExit):
        return
    name = "?" if hook.thread is None else hook.thread.name
    trace = (hook.exc_type, hook.exc_value, hook.exc_traceback)
    logging.getLogger(__name__).error("the thread %s was ended by an error", name, exc_info=trace)


def _at(record: logging.LogRecord) -> datetime:
    return datetime.fromtimestamp(record.created, UTC)


def _traceback(formatter: logging.Formatter, record: logging.LogRecord) -> str:
    parts = [formatter.formatException(record.exc_info)] if record.exc_info and record.exc_info[0] else []
    if record.stack_info:
        parts.append(formatter.formatStack(record.stack_info))
    return "\n".join(parts)
