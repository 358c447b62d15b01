"""The service's log: one JSON document per line from every logger, and a reader that stops reading blocks nothing."""

import asyncio
import contextvars
import io
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
from prometheus_client import CollectorRegistry
from starlette.types import Message, Receive, Scope, Send

from service.logs.setup import JsonFormatter, TextFormatter, request_log_context, scan_log_context
from service.logs.writer import LogWriter
from service.metrics.requests import AccessLogMiddleware, RequestMetrics

ROOT = Path(__file__).resolve().parents[3]
WHERE = ("name", logging.WARNING, "file.py", 1)


def format_line(formatter: logging.Formatter, message: str, *arguments: object, **more: Any) -> str:
    record = logging.LogRecord(*WHERE, message, arguments, None)
    record.created = 1_767_323_045.678
    vars(record).update(more)
    return formatter.format(record)


def test_a_record_is_one_line_of_json() -> None:
    line = format_line(JsonFormatter(), "a %s\nline, “so”", "second")
    assert "\n" not in line
    assert json.loads(line) == {
        "at": "2026-01-02T03:04:05.678Z",
        "level": "warning",
        "logger": "name",
        "message": "a second\nline, “so”",
        "process": "MainProcess",
        "thread": threading.current_thread().name,
    }


def test_an_exception_is_one_string_with_its_traceback() -> None:
    try:
        raise ValueError("why")
    except ValueError:
        error = sys.exc_info()
    document = json.loads(format_line(JsonFormatter(), "x", exc_info=error))
    assert document["exception"].startswith("Traceback")
    assert document["exception"].endswith("ValueError: why")
    assert format_line(TextFormatter(), "x", exc_info=error).count("\n") > 2


def test_records_of_a_scan_have_its_id() -> None:
    formatter = JsonFormatter()
    with scan_log_context("s1"), request_log_context("r1"):
        document = json.loads(format_line(formatter, "x"))
        assert (document["scan"], document["request"]) == ("s1", "r1")
        assert format_line(TextFormatter(), "x").endswith("warning name: x (scan s1)")
        # A thread that runs in a copy of the context, as the thread that moves the arm does.
        found: list[str] = []
        run = contextvars.copy_context().run
        thread = threading.Thread(target=run, args=(lambda: found.append(format_line(formatter, "x")),))
        thread.start()
        thread.join()
        assert json.loads(found[0])["scan"] == "s1"
    assert "scan" not in json.loads(format_line(formatter, "x"))


def test_a_blocked_reader_does_not_block_logging() -> None:
    ours, theirs = os.pipe()
    with os.fdopen(theirs, "w") as stream, os.fdopen(ours) as reader:
        writer = LogWriter(stream, max_lines=10)
        writer.setFormatter(JsonFormatter())
        for _ in range(3):  # more than the buffer of a pipe
            writer.emit(logging.LogRecord(*WHERE, "x" * 50_000, (), None))
        for number in range(100):
            writer.emit(logging.LogRecord(*WHERE, f"line {number}", (), None))
        messages: list[str] = []
        reading = threading.Thread(target=lambda: messages.extend(json.loads(one)["message"] for one in reader))
        reading.start()
        writer.close()
        stream.close()
        reading.join()
    short = [message for message in messages if len(message) < 100]
    # The loss is logged and the rest is in order. Which lines are lost depends on when the writer took the first.
    assert any("lines lost" in message for message in short)
    kept = [int(message.removeprefix("line ")) for message in short if "lost" not in message]
    assert kept == sorted(set(kept))
    assert 0 < len(kept) < 100


def test_a_closed_stream_raises_no_error() -> None:
    stream = io.StringIO()
    writer = LogWriter(stream)
    stream.close()
    writer.emit(logging.LogRecord(*WHERE, "x", (), None))
    writer.close()


@pytest.fixture
def logged() -> Callable[[str], list[dict[str, Any]]]:
    """`logged(code)`: the records of a new process that runs `code` after the import of `configure_logging`."""

    def run(code: str) -> list[dict[str, Any]]:
        start = "import logging, sys\nfrom service.logs.setup import configure_logging\n"
        ran = subprocess.run(
            [sys.executable, "-c", start + code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120
        )
        return [json.loads(line) for line in ran.stderr.splitlines()]

    return run


def test_all_loggers_of_a_process_use_the_same_handler(logged: Callable[[str], list[dict[str, Any]]]) -> None:
    code = """
configure_logging("auto", "info")
import threading, warnings
import uvicorn
uvicorn.Config("x", log_config=None, access_log=False)
logging.getLogger("uvicorn.error").info("up")
logging.getLogger("uvicorn.access").info("never")
logging.getLogger("a").debug("never")
warnings.warn("old")
def fail():
    raise ValueError("why")
thread = threading.Thread(target=fail, name="t1")
thread.start()
thread.join()
"""
    up, old, failed = logged(code)
    assert (up["logger"], up["level"], up["message"]) == ("uvicorn.error", "info", "up")
    assert (old["logger"], "old" in old["message"]) == ("py.warnings", True)
    assert "t1" in failed["message"]
    assert failed["exception"].endswith("ValueError: why")


def test_a_device_process_logs_in_the_format_of_its_parent(logged: Callable[[str], list[dict[str, Any]]]) -> None:
    code = """
configure_logging("json", "info")
from cell.process.child import Child
from tests.service.logs.test_setup import LoggingDriver
child = Child("arm", LoggingDriver)
child.call("talk", timeout_s=60)
child.close()
"""
    (record,) = logged(code)
    assert (record["message"], record["process"], record["logger"]) == ("from the child", "arm", "driver")


class LoggingDriver:
    """A driver that logs a line."""

    def talk(self) -> None:
        """Log a line."""
        logging.getLogger("driver").info("from the child")

    def close(self) -> None:
        """Do nothing: there is nothing to close."""


def test_a_request_is_one_line_without_its_query_string(
    client: httpx2.Client, caplog: pytest.LogCaptureFixture
) -> None:
    def access_record(path: str) -> logging.LogRecord:
        caplog.clear()
        client.get(path)
        # The record is written at the end of the request, which may be after its answer has arrived.
        while not (lines := [record for record in caplog.records if record.name == "service.access"]):
            time.sleep(0.005)
        (record,) = lines
        return record

    with caplog.at_level(logging.DEBUG, "service.access"):
        record = access_record("/api/scans/none?what=a-secret")
        access: dict[str, Any] = vars(record)["access"]
        assert access["duration_s"] > 0
        shown = {key: value for key, value in access.items() if key != "duration_s"}
        assert shown == {"method": "GET", "path": "/api/scans/none", "status": 422, "who": "local"}
        assert "a-secret" not in record.getMessage()
        assert record.levelname == "INFO"
        assert access_record("/healthz").levelname == "DEBUG"
        assert "\n" not in access_record("/api/a%0Ab").getMessage()


def test_a_request_that_starts_or_stops_a_scan_is_logged_with_its_id(caplog: pytest.LogCaptureFixture) -> None:
    def logged_scan(path: str, answer: dict[str, Any], **state: str) -> str | None:
        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            await send({"type": "http.response.start"} | answer)

        async def discard(_: Message) -> None: ...

        scope = {"type": "http", "method": "POST", "path": path, "headers": [], "state": state}
        written = io.StringIO()
        handler = logging.StreamHandler(written)
        handler.setFormatter(JsonFormatter())
        logger = logging.getLogger("service.access")
        logger.addHandler(handler)
        try:
            asyncio.run(AccessLogMiddleware(app, RequestMetrics(CollectorRegistry()))(scope, None, discard))  # type: ignore[arg-type]
        finally:
            logger.removeHandler(handler)
        return json.loads(written.getvalue()).get("scan")

    started = [(b"location", b"/api/scans/s-2")]
    with caplog.at_level(logging.INFO, "service.access"):
        assert logged_scan("/api/scans", {"status": 202, "headers": started}) == "s-2"
        assert logged_scan("/api/scans", {"status": 409, "headers": started}) is None  # that scan blocks the request
        assert logged_scan("/api/scans/s-1/reprocess", {"status": 202, "headers": started}) == "s-2"
        assert logged_scan("/api/cell/stop", {"status": 200, "headers": []}, stopped_scan="s-3") == "s-3"
        assert logged_scan("/api/scans/s-1/cancel", {"status": 200}) == "s-1"
