"""The service's log: one JSON document a line, whoever logs, and nobody waits for who reads it."""

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

import httpx
import pytest
from prometheus_client import CollectorRegistry
from starlette.types import Message, Receive, Scope, Send

from service.logs.setup import JsonFormatter, TextFormatter, log_request, log_scan
from service.logs.writer import LogWriter
from service.metrics.requests import RequestMetrics, RequestWatch

ROOT = Path(__file__).resolve().parents[3]
WHERE = ("name", logging.WARNING, "file.py", 1)


def line(form: logging.Formatter, message: str, *arguments: object, **more: Any) -> str:
    record = logging.LogRecord(*WHERE, message, arguments, None)
    record.created = 1_767_323_045.678
    vars(record).update(more)
    return form.format(record)


def test_a_record_is_one_line_of_json() -> None:
    told = line(JsonFormatter(), "a %s\nline, “so”", "second")
    assert "\n" not in told
    assert json.loads(told) == {
        "at": "2026-01-02T03:04:05.678Z",
        "level": "warning",
        "logger": "name",
        "message": "a second\nline, “so”",
        "process": "MainProcess",
        "thread": threading.current_thread().name,
    }


def test_an_error_is_one_string_with_its_traceback() -> None:
    try:
        raise ValueError("why")
    except ValueError:
        error = sys.exc_info()
    told = json.loads(line(JsonFormatter(), "x", exc_info=error))
    assert told["exception"].startswith("Traceback")
    assert told["exception"].endswith("ValueError: why")
    assert line(TextFormatter(), "x", exc_info=error).count("\n") > 2


def test_what_is_logged_in_a_scan_has_its_id() -> None:
    form = JsonFormatter()
    with log_scan("s1"), log_request("r1"):
        told = json.loads(line(form, "x"))
        assert (told["scan"], told["request"]) == ("s1", "r1")
        assert line(TextFormatter(), "x").endswith("warning name: x (scan s1)")
        # A thread that is given the context, as the one that moves the arm is.
        found: list[str] = []
        run = contextvars.copy_context().run
        thread = threading.Thread(target=run, args=(lambda: found.append(line(form, "x")),))
        thread.start()
        thread.join()
        assert json.loads(found[0])["scan"] == "s1"
    assert "scan" not in json.loads(line(form, "x"))


def test_a_reader_that_does_not_read_keeps_nobody_waiting() -> None:
    ours, theirs = os.pipe()
    with os.fdopen(theirs, "w") as stream, os.fdopen(ours) as reader:
        writer = LogWriter(stream, most_lines=10)
        writer.setFormatter(JsonFormatter())
        for _ in range(3):  # more than a pipe holds, in records
            writer.emit(logging.LogRecord(*WHERE, "x" * 50_000, (), None))
        for number in range(100):
            writer.emit(logging.LogRecord(*WHERE, f"line {number}", (), None))
        told: list[str] = []
        reading = threading.Thread(target=lambda: told.extend(json.loads(one)["message"] for one in reader))
        reading.start()
        writer.close()
        stream.close()
        reading.join()
    short = [message for message in told if len(message) < 100]
    # That some were lost is said, and the rest is in order; which ones depends on when the writer took the first.
    assert any("lines lost" in message for message in short)
    kept = [int(message.removeprefix("line ")) for message in short if "lost" not in message]
    assert kept == sorted(set(kept))
    assert 0 < len(kept) < 100


def test_a_stream_that_was_closed_harms_nobody() -> None:
    stream = io.StringIO()
    writer = LogWriter(stream)
    stream.close()
    writer.emit(logging.LogRecord(*WHERE, "x", (), None))
    writer.close()


@pytest.fixture
def logged() -> Callable[[str], list[dict[str, Any]]]:
    """`logged(code)`: what a process of its own logs that runs this behind `start_log`."""

    def run(code: str) -> list[dict[str, Any]]:
        start = "import logging, sys\nfrom service.logs.setup import start_log\n"
        ran = subprocess.run(
            [sys.executable, "-c", start + code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=120
        )
        return [json.loads(told) for told in ran.stderr.splitlines()]

    return run


def test_whatever_logs_in_the_process_goes_the_same_way(logged: Callable[[str], list[dict[str, Any]]]) -> None:
    code = """
start_log("auto", "info")
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


def test_a_device_process_logs_as_its_parent_does(logged: Callable[[str], list[dict[str, Any]]]) -> None:
    code = """
start_log("json", "info")
from cell.process.child import Child
from tests.service.logs.test_setup import Talkative
child = Child("arm", Talkative)
child.call("talk", timeout_s=60)
child.close()
"""
    (told,) = logged(code)
    assert (told["message"], told["process"], told["logger"]) == ("from the child", "arm", "talkative")


class Talkative:
    """A driver that logs."""

    def talk(self) -> None:
        """Logs a line."""
        logging.getLogger("talkative").info("from the child")

    def close(self) -> None:
        """Nothing to close."""


def test_a_request_is_one_line_without_what_nobody_should_read(
    client: httpx.Client, caplog: pytest.LogCaptureFixture
) -> None:
    def told(path: str) -> logging.LogRecord:
        caplog.clear()
        client.get(path)
        # Written when the request is over, which may be after its answer has come.
        while not (lines := [record for record in caplog.records if record.name == "service.access"]):
            time.sleep(0.005)
        (record,) = lines
        return record

    with caplog.at_level(logging.DEBUG, "service.access"):
        record = told("/api/scans/none?what=a-secret")
        access: dict[str, Any] = vars(record)["access"]
        assert access["duration_s"] > 0
        shown = {key: value for key, value in access.items() if key != "duration_s"}
        assert shown == {"method": "GET", "path": "/api/scans/none", "status": 422, "who": "local"}
        assert "a-secret" not in record.getMessage()
        assert record.levelname == "INFO"
        assert told("/healthz").levelname == "DEBUG"
        assert "\n" not in told("/api/a%0Ab").getMessage()


def test_what_begins_or_stops_a_scan_is_logged_with_it(caplog: pytest.LogCaptureFixture) -> None:
    def told(path: str, answer: dict[str, Any], **state: str) -> str | None:
        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            await send({"type": "http.response.start"} | answer)

        async def nowhere(_: Message) -> None: ...

        scope = {"type": "http", "method": "POST", "path": path, "headers": [], "state": state}
        written = io.StringIO()
        handler = logging.StreamHandler(written)
        handler.setFormatter(JsonFormatter())
        logger = logging.getLogger("service.access")
        logger.addHandler(handler)
        try:
            asyncio.run(RequestWatch(app, RequestMetrics(CollectorRegistry()))(scope, None, nowhere))  # type: ignore[arg-type]
        finally:
            logger.removeHandler(handler)
        return json.loads(written.getvalue()).get("scan")

    started = [(b"location", b"/api/scans/s-2")]
    with caplog.at_level(logging.INFO, "service.access"):
        assert told("/api/scans", {"status": 202, "headers": started}) == "s-2"
        assert told("/api/scans", {"status": 409, "headers": started}) is None  # that one is in the way
        assert told("/api/scans/s-1/reprocess", {"status": 202, "headers": started}) == "s-2"
        assert told("/api/cell/stop", {"status": 200, "headers": []}, stopped_scan="s-3") == "s-3"
        assert told("/api/scans/s-1/cancel", {"status": 200}) == "s-1"
