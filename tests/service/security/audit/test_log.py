"""The audit log has every change and every refusal, and writing it delays no stop."""

import asyncio
import json
import logging
import sqlite3
import threading
from contextlib import closing
from functools import partial
from pathlib import Path

import httpx2
import pytest
from starlette.types import Message, Receive, Scope, Send

from service.cli.main import main
from service.security.audit import cli_audit
from service.security.audit import log as audit
from service.security.audit.log import AuditLog, Entry
from service.security.audit.reader import AuditError, read_audit
from service.security.audit.repeats import MAX_KINDS, RepeatCounter
from service.security.auth.tokens import TokenFile
from service.security.middleware.audit_recorder import AuditMiddleware
from service.storage.data_folder import DATABASE, DataFolder
from service.storage.store import Store
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.security.conftest import Guarded, without_recognition


def entries(data: Path, **wanted: str | None) -> list[Entry]:
    return read_audit(data, wanted.get("since"), wanted.get("scan"), wanted.get("who"), 10_000)


def test_a_change_is_written_before_its_answer(client: ServedClient, recording: str, held: int) -> None:
    data = client.app.state.context.store.folder.root
    before = len(entries(data))
    client.get("/api/scans")  # a read is not written
    started = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    scan = started.json()["id"]
    (entry,) = entries(data)[before:]
    assert (entry.who, entry.role, entry.what, entry.scan) == ("local", "maintainer", "POST /api/scans", scan)
    assert (entry.cell, entry.status, entry.result) == ("not_ready", 202, None)
    refused = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    assert refused.status_code == 409
    (entry,) = entries(data)[before + 1 :]
    assert (entry.status, entry.result, entry.scan) == (409, "cell-busy", None)
    client.post(f"/api/scans/{scan}/cancel")
    wait_until(lambda: len(entries(data)) > before + 2)  # a cancel does not wait for its entry
    cancelled = entries(data, scan=scan)[-1]
    assert (cancelled.what, cancelled.status) == (f"POST /api/scans/{scan}/cancel", 200)
    assert [one.scan for one in entries(data, scan=scan)] == [scan, scan]


def test_a_repeated_request_is_marked_as_replayed(client: ServedClient, recording: str, held: int) -> None:
    body, key = {"mode": "replay", "recording": recording}, {"Idempotency-Key": f"audit {recording}"}
    scan, again = (client.post("/api/scans", json=body, headers=key).json()["id"] for _ in range(2))
    assert scan == again
    client.post(f"/api/scans/{scan}/cancel")
    found = entries(client.app.state.context.store.folder.root, scan=scan)[:2]
    assert [(one.what, one.status, one.result) for one in found] == [
        ("POST /api/scans", 202, None),
        ("POST /api/scans", 202, "replayed"),
    ]


def test_an_entry_has_the_scan_that_its_request_affected(database: Path) -> None:
    """A reprocess has the new scan, and is found by its source too. A stop has the scan that it stopped."""
    log = AuditLog()
    log.start(partial(sqlite3.connect, database), lambda: "busy")

    def request(path: str, status: int, location: str | None = None, **state: str) -> None:
        async def answer(scope: Scope, receive: Receive, send: Send) -> None:
            headers = [] if location is None else [(b"Location", location.encode())]
            await send({"type": "http.response.start", "status": status, "headers": headers})

        async def discard(_: Message) -> None: ...

        scope = {"type": "http", "method": "POST", "path": path, "client": ("::1", 1), "headers": [], "state": state}
        asyncio.run(AuditMiddleware(answer, log)(scope, None, discard))  # type: ignore[arg-type]

    request("/api/scans/s-1/reprocess", 202, "/api/scans/s-2")
    request("/api/scans/s-1/reprocess", 409, "/api/scans/s-3", problem="cell-busy")  # that scan blocks the request
    request("/api/cell/stop", 200, stopped_scan="s-2")
    request("/api/cell/stop", 200)
    request("/api/scans/s-11/cancel", 200)
    log.close()
    found = [(one.what.rpartition("/")[2], one.scan) for one in entries(database.parent)]
    assert found == [("reprocess", "s-2"), ("reprocess", "s-1"), ("stop", "s-2"), ("stop", None), ("cancel", "s-11")]
    assert [one.scan for one in entries(database.parent, scan="s-1")] == ["s-2", "s-1"]
    assert [one.status for one in entries(database.parent, scan="s-2")] == [202, 200]


def test_a_change_of_the_tokens_is_written(
    database: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    data_dir = ["--data-dir", str(database.parent)]
    assert main(["token", "add", "anna", "--role", "operator", *data_dir]) == 0
    assert main(["token", "remove", "anna", *data_dir]) == 0
    assert "audit" not in capsys.readouterr().err
    assert main(["token", "remove", "anna", *data_dir]) == 1  # nothing was changed
    assert [vars(one) | {"at": ""} for one in entries(database.parent, who="console")] == [
        vars(Entry("", "console", "maintainer", what, None, "unknown", 0, None))
        for what in ("token add anna operator", "token remove anna")
    ]
    capsys.readouterr()

    monkeypatch.setattr(cli_audit, "DATABASE_TIMEOUT_S", 0.02)
    with closing(sqlite3.connect(database, isolation_level=None)) as holder:
        holder.execute("BEGIN IMMEDIATE")
        assert main(["token", "add", "bert", "--role", "viewer", *data_dir]) == 0
    output = capsys.readouterr()
    assert TokenFile(database.parent).find(output.out.strip()) is not None
    assert "the audit log has no entry of it" in output.err
    assert "locked" in output.err
    assert len(entries(database.parent)) == 2

    fresh = tmp_path / "fresh"
    assert main(["token", "add", "bert", "--role", "viewer", "--data-dir", str(fresh)]) == 0
    assert "the audit log has no entry of it: it begins when the service first starts" in capsys.readouterr().err
    assert not (fresh / DATABASE).exists()


@pytest.mark.problem("unauthorized")
def test_repeated_refusals_are_written_once_and_counted(guarded: Guarded) -> None:
    known = len(entries(guarded.data))
    for _ in range(20):
        guarded.client.get("/api/cell", headers={"Authorization": "Bearer pct_nobody"})
        guarded.client.post("/api/recordings", headers=guarded.headers["viewer"], content=b"x")
        guarded.client.get("/api/cell", headers={"Host": "evil.example"})
    new = [(one.who, one.role, one.what, one.status, one.result) for one in entries(guarded.data)[known:]]
    # An earlier test may have caused the first 401 of this minute.
    assert ("viewer", "viewer", "POST /api/recordings", 403, "forbidden") in new
    assert ("127.0.0.1", "none", "GET /api/cell", 421, "host-not-allowed") in new
    assert len(new) <= 3
    assert not [one for one in entries(guarded.data) if "pct_" in one.what]


def test_the_first_event_of_each_kind_is_reported_and_then_the_number_of_repeats() -> None:
    repeats: RepeatCounter[str] = RepeatCounter(window_s=60.0)
    assert repeats.is_first("a", "one", 0.0)
    assert not repeats.is_first("a", "two", 1.0)
    assert not repeats.is_first("a", "three", 59.0)
    assert repeats.is_first("b", "other", 2.0)
    assert repeats.pop_ended(59.0) == []
    assert repeats.pop_ended(60.0) == [("one", 2)]
    assert repeats.is_first("a", "four", 61.0)
    assert repeats.pop_ended(62.0, everything=True) == []
    assert sum(repeats.is_first(k, "x", 70.0) for k in range(10 * MAX_KINDS)) == MAX_KINDS + 1
    assert len(repeats.pop_ended(200.0)) == 1


@pytest.fixture
def database(tmp_path: Path) -> Path:
    folder = DataFolder(tmp_path)
    Store(folder).close()
    folder.close()
    return tmp_path / DATABASE


def test_entries_that_the_database_does_not_accept_are_written_later(
    database: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(audit, "RETRY_S", 0.02)
    monkeypatch.setattr(audit, "WRITE_TIMEOUT_S", 0.1)
    monkeypatch.setattr(audit, "MAX_PENDING", 5)
    log = AuditLog()
    log.add("service", "start")  # before there is a database
    holder = sqlite3.connect(database, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    log.start(partial(sqlite3.connect, database), lambda: "ready")
    for k in range(4):
        asyncio.run(log.record("anna", "operator", f"POST /{k}", None, 200, None, wait=True))
    with caplog.at_level(logging.ERROR):
        for _ in range(10):  # more than `MAX_PENDING`
            log.add("service", "too many")
    assert len([record for record in caplog.records if "loses" in record.message]) == 1
    assert read_audit(database.parent, None, None, None, 100) == []  # the log can be read meanwhile
    holder.execute("ROLLBACK")
    holder.close()
    wait_until(lambda: len(entries(database.parent)) == 5)
    found = entries(database.parent)
    assert [one.what for one in found] == ["start", "POST /0", "POST /1", "POST /2", "POST /3"]
    assert [one.cell for one in found] == ["not_ready"] + ["ready"] * 4
    wait_until(lambda: "has lost 10 entries" in caplog.text)
    asyncio.run(log.record("anna", "operator", "POST /5", None, 200, None, wait=True))
    assert len(entries(database.parent)) == 6  # written at once again
    log.close()


def test_the_end_of_the_service_does_not_wait_for_a_locked_database(
    database: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(audit, "RETRY_S", 0.02)
    monkeypatch.setattr(audit, "CLOSE_TIMEOUT_S", 0.1)
    log = AuditLog()
    log.start(partial(sqlite3.connect, database), lambda: "ready")
    holder = sqlite3.connect(database, isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    log.add("service", "end")
    log.close()
    holder.close()
    assert "has lost 1 entries" in caplog.text


def test_rows_are_only_ever_added(database: Path) -> None:
    log = AuditLog()
    log.start(partial(sqlite3.connect, database), lambda: "ready")
    log.add("a", "b", scan="c", result="d")
    log.close()
    with sqlite3.connect(database) as db:
        for sql in ("DELETE FROM audit", "UPDATE audit SET who = 'x'"):
            with pytest.raises(sqlite3.IntegrityError, match="only ever added to"):
                db.execute(sql)
    db.close()
    assert [(one.who, one.role, one.status) for one in entries(database.parent)] == [("a", "service", 0)]


def test_entries_of_several_threads_are_all_written(database: Path) -> None:
    log = AuditLog()
    log.start(partial(sqlite3.connect, database), lambda: "ready")

    def add() -> None:
        for k in range(50):
            log.add("a", str(k))

    threads = [threading.Thread(target=add) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    log.close()
    assert len(entries(database.parent)) == 200


def test_start_and_end_of_the_service_are_written(serve: Serve, tmp_path: Path) -> None:
    with without_recognition(serve, tmp_path) as client:
        client.post("/api/cell/stop")
    assert {path.name for path in tmp_path.glob("pointchain.sqlite3*")} == {DATABASE}  # the database was closed
    assert [one.what for one in entries(tmp_path)] == ["start", "POST /api/cell/stop", "end"]


def test_the_log_is_printed_on_the_command_line(
    guarded: Guarded, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The command works while the service runs."""
    guarded.client.post("/api/cell/stop", headers=guarded.headers["operator"])
    wait_until(lambda: bool(entries(guarded.data, who="operator")))
    data_dir = ["--data-dir", str(guarded.data)]
    assert main(["audit", "--who", "operator", "--since", "2026-01-31", "--json", *data_dir]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert all(line["who"] == "operator" for line in lines)
    assert lines[-1]["what"] == "POST /api/cell/stop"
    assert main(["audit", "--who", "operator", "--limit", "1", *data_dir]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert "operator (operator)  POST /api/cell/stop  200  cell " in line
    for wanted in (["--since", "2999-01-01"], ["--scan", "none"], ["--who", "nobody"]):
        assert main(["audit", *wanted, *data_dir]) == 0
        output = capsys.readouterr()
        assert (output.out, output.err) == ("", "no entry was found\n")
    assert main(["audit", "--data-dir", str(tmp_path)]) == 1
    assert "no service has run" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["audit", "--since", "yesterday", *data_dir])
    (tmp_path / DATABASE).write_bytes(b"x" * 5000)
    with pytest.raises(AuditError):
        read_audit(tmp_path, None, None, None, 1)


def test_a_cancelled_request_is_written(database: Path) -> None:
    log = AuditLog()
    log.start(partial(sqlite3.connect, database), lambda: "busy")

    async def never(*_: object) -> None:
        await asyncio.Event().wait()

    async def run() -> None:
        scope = {
            "type": "http",
            "method": "POST",
            "path": "/api/scans/x-1/reprocess",
            "client": ("::1", 1),
            "headers": [],
        }
        task = asyncio.create_task(AuditMiddleware(never, log)(scope, never, never))  # type: ignore[arg-type]
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait([task])

    asyncio.run(run())
    log.close()
    (entry,) = entries(database.parent)
    assert (entry.who, entry.what, entry.scan) == ("::1", "POST /api/scans/x-1/reprocess", "x-1")
    assert (entry.status, entry.result) == (0, "interrupted")


def test_an_unexpected_error_is_written(client: ServedClient, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("on purpose")

    monkeypatch.setattr("service.jobs.manager.Jobs.release_arm", fail)
    answer: httpx2.Response = client.post("/api/cell/release")
    assert answer.status_code == 500
    found = entries(client.app.state.context.store.folder.root)[-1]
    assert (found.what, found.status, found.result) == ("POST /api/cell/release", 500, "internal")
