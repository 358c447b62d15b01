"""Logging to stderr: one JSON document per line for programs, or plain lines for people.

A record that is logged during a scan has the scan's id: in the scan's thread, in its recognition process, and in the
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
from service.clock import format_utc
from service.logs.writer import LogWriter

Format = Literal["auto", "json", "text"]
Level = Literal["debug", "info", "warning", "error"]

NOISY_LIBRARIES = ("matplotlib", "PIL")
"""Libraries whose debug records say nothing about the service. They are logged from the level warning."""
ENCODER = json.JSONEncoder(ensure_ascii=False, default=str)

_scan: ContextVar[str | None] = ContextVar("scan", default=None)
_request: ContextVar[str | None] = ContextVar("request", default=None)


@contextmanager
def scan_log_context(scan_id: str | None) -> Iterator[None]:
    """Add the scan's id to every record that is logged in the body, or in a copy of its context."""
    token = _scan.set(scan_id)
    try:
        yield
    finally:
        _scan.reset(token)


@contextmanager
def request_log_context(request_id: str) -> Iterator[None]:
    """Add the request's id to every record that is logged in the body, or in a copy of its context."""
    token = _request.set(request_id)
    try:
        yield
    finally:
        _request.reset(token)


class JsonFormatter(logging.Formatter):
    """Formats a record as one line of JSON.

    The members are `at` (RFC 3339, UTC), `level`, `logger`, `message`, `process` and `thread`; `scan`, `request` and
    `exception` if there is one; and the members of the record's attribute `access`, if it has one.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, without a line break at its end."""
        document: dict[str, Any] = {
            "at": format_utc(_time_of(record)),
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
    """Formats a record for people: time, level, logger and message. A traceback follows on its own lines."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines, without a line break at the end."""
        time = _time_of(record).astimezone().strftime("%H:%M:%S")
        line = f"{time} {record.levelname.lower():8}{record.name}: {record.getMessage()}"
        if (scan := _scan.get()) is not None and scan not in line:
            line += f" (scan {scan})"
        traceback = _traceback(self, record)
        return f"{line}\n{traceback}" if traceback else line


def configure_logging(form: Format, level: Level) -> Literal["json", "text"]:
    """Send the log of this process, and of the child processes that it starts, to stderr.

    Handlers that were installed before are replaced. uvicorn's loggers use the same handler; only its line per request
    is dropped.

    Args:
        form: Format of the lines. `auto` is `text` on a terminal and `json` elsewhere.
        level: Lowest level that is logged.

    Returns:
        The format in use.
    """
    if form == "auto":
        form = "text" if sys.stderr.isatty() else "json"
    _install_handler(LogWriter(sys.stderr), form, level)
    for name in ("uvicorn", "uvicorn.error", "uvicorn.access"):
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = name != "uvicorn.access"
    logging.captureWarnings(True)
    threading.excepthook = _log_thread_exception
    configure_child_logging(partial(configure_child_process, form, level))
    return form


def configure_child_process(form: Format, level: Level, name: str) -> None:
    """Send the log of a child process to stderr in the same format.

    Args:
        form: Format of the lines.
        level: Lowest level that is logged.
        name: Name of the process.
    """
    multiprocessing.current_process().name = name
    _install_handler(logging.StreamHandler(sys.stderr), form, level)


def _install_handler(handler: logging.Handler, form: Format, level: Level) -> None:
    handler.setFormatter(JsonFormatter() if form == "json" else TextFormatter())
    root = logging.getLogger()
    for previous in root.handlers[:]:
        root.removeHandler(previous)
        previous.close()
    root.addHandler(handler)
    root.setLevel(level.upper())
    for name in NOISY_LIBRARIES:
        logging.getLogger(name).setLevel(logging.WARNING)


def _log_thread_exception(hook: threading.ExceptHookArgs) -> None:
    if hook.exc_value is None or issubclass(hook.exc_type, SystemExit):
        return
    name = "?" if hook.thread is None else hook.thread.name
    trace = (hook.exc_type, hook.exc_value, hook.exc_traceback)
    logging.getLogger(__name__).error("an unhandled exception ended the thread %s", name, exc_info=trace)


def _time_of(record: logging.LogRecord) -> datetime:
    return datetime.fromtimestamp(record.created, UTC)


def _traceback(formatter: logging.Formatter, record: logging.LogRecord) -> str:
    parts = [formatter.formatException(record.exc_info)] if record.exc_info and record.exc_info[0] else []
    if record.stack_info:
        parts.append(formatter.formatStack(record.stack_info))
    return "\n".join(parts)
