"""`/healthz` and `/readyz` report the health of the service. Each failed check is named."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tests.service.conftest import ServedClient, wait_until

AssertProblem = Callable[[httpx2.Response, int, str], str]
Serve = Callable[..., AbstractContextManager[ServedClient]]


@pytest.fixture
def ready(client: ServedClient) -> ServedClient:
    """Return the shared service when it is ready."""
    wait_until(lambda: client.get("/readyz").status_code == 200)
    return client


def checks(answer: httpx2.Response) -> dict[str, Any]:
    """Return the result of each check, by name."""
    return {name: check["ok"] for name, check in answer.json()["checks"].items() if name != "cell"}


ALL_OK = {"store": True, "recognition": True, "disk": True, "service": True}


@contextmanager
def locked(database: Path) -> Iterator[None]:
    """Hold the database exclusively from another connection."""
    with closing(sqlite3.connect(database)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


def test_all_checks_are_reported_by_name(ready: ServedClient) -> None:
    answer = ready.get("/readyz")
    assert answer.json()["status"] == "ready"
    assert checks(answer) == ALL_OK
    # a cell that is not connected is reported, and the service is ready
    assert answer.json()["checks"]["cell"] == ready.get("/api/cell").json()["state"]
    assert ready.get("/healthz").json() == {"status": "ok"}


def test_a_fault_of_the_cell_leaves_the_service_ready(ready: ServedClient, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ready.app.state.context.cell
    fault = replace(cell.status, state="fault", slug="robot-lost", reason="look at it")
    monkeypatch.setattr(type(cell), "status", fault)
    answer = ready.get("/readyz")
    assert (answer.status_code, answer.json()["checks"]["cell"]) == (200, "fault")


def test_a_locked_store_is_not_ready(ready: ServedClient, assert_problem: AssertProblem) -> None:
    with locked(ready.app.state.context.store.folder.database):
        answer = ready.get("/readyz")
        assert "store: it accepts no changes: database is locked" in assert_problem(answer, 503, "not-ready")
        assert checks(answer) == ALL_OK | {"store": False}
        assert answer.headers["retry-after"] == "1"
        assert ready.get("/healthz").status_code == 200
    assert ready.get("/readyz").status_code == 200


def test_unreadable_tokens_are_not_ready(ready: ServedClient, assert_problem: AssertProblem) -> None:
    tokens = ready.app.state.context.store.folder.root / "tokens.json"
    tokens.write_text("{")
    try:
        assert_problem(ready.post("/api/cell/stop"), 401, "unauthorized")
        answer = ready.get("/readyz")
        detail = assert_problem(answer, 503, "not-ready")
        assert "service: tokens.json is damaged: Invalid JSON" in detail
        assert "clients may be refused, also when they stop the arm" in detail
        assert str(tokens.parent) not in answer.text, "everyone may read the answer, so it must not name the folder"
        assert checks(answer) == ALL_OK | {"service": False}
    finally:
        tokens.unlink()
    assert ready.get("/readyz").status_code == 200


def test_a_full_disk_and_a_stopping_service_are_not_ready(
    ready: ServedClient, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "service.api.routes.health.shutil.disk_usage", lambda _: type("Usage", (), {"free": 10 << 20})()
    )
    monkeypatch.setattr("service.jobs.manager.Jobs.closed", True)
    answer = ready.get("/readyz")
    detail = assert_problem(answer, 503, "not-ready")
    assert "disk: 10 MiB are free" in detail
    assert "the service is stopping" in detail
    assert checks(answer) == ALL_OK | {"disk": False, "service": False}
