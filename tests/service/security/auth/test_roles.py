"""The table of roles, and that no request bypasses it."""

import sqlite3
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import httpx2
import pytest
from fastapi.routing import iter_route_contexts
from starlette.routing import Mount

from service.app import create_app
from service.config.loader import ServiceConfig
from service.security.auth.caller import ROLES, Caller
from service.security.auth.roles import DOCS_FILES, MIN_ROLE, Call, OtherMethods, find_call
from service.security.auth.tokens import add_token, remove_token
from service.storage.database import BUSY_S
from tests.service.conftest import PATIENCE_S, Serve, wait_until
from tests.service.security.conftest import Guarded, bearer, connect, port_of, without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]

THREADS = 40
"""Size of the thread pool of all requests that may block, except stops."""


def routes() -> set[str]:
    found = set()
    for route in iter_route_contexts(create_app(ServiceConfig()).routes):
        if isinstance(route.original_route, Mount):  # a folder of static files
            found.add(f"GET {route.path}/{{path:path}}")
        else:
            assert route.methods, f"{route.path}: the table does not support routes of this kind"
            found |= {f"{method} {route.path}" for method in route.methods}
    return found


def test_the_table_has_exactly_the_routes() -> None:
    assert routes() == set(MIN_ROLE)


def test_each_address_matches_one_call_only() -> None:
    """Otherwise the router could choose another call than the table."""
    for name in MIN_ROLE:
        method, _, path = name.partition(" ")
        example = path.replace("{path:path}", "a/b").replace("{id}", "x").replace("{index}", "3")
        found = find_call(method, example)
        assert isinstance(found, Call)
        assert found.name == name


def test_calls_outside_the_table_do_not_exist() -> None:
    for path in ("/api", "/api/", "/api/scans/", "/api/scans//model", "/api/cell\n", "/API/cell", "//api/cell"):
        assert find_call("GET", path) is None
    assert find_call("PATCH", "/api/scans/x") == OtherMethods(("DELETE", "GET", "HEAD"))
    assert find_call("get", "/api/cell") == OtherMethods(("GET", "HEAD"))


def test_a_role_includes_all_lower_roles() -> None:
    for k, role in enumerate(ROLES):
        assert [Caller("a", role).has_role(other) for other in ROLES] == [other in ROLES[: k + 1] for other in ROLES]


def test_without_a_token_only_public_calls_answer(guarded: Guarded, assert_problem: AssertProblem) -> None:
    for path in ("/healthz", "/docs", "/docs/start.js", f"{DOCS_FILES}/swagger-ui.css", "/openapi.json", "/manual/"):
        assert guarded.client.get(path).status_code == 200, path
    for name, role in MIN_ROLE.items():
        method, _, path = name.partition(" ")
        if role != "open":
            answer = guarded.client.request(method, path.replace("{id}", "x").replace("{index}", "3"))
            assert_problem(answer, 401, "unauthorized")
            assert answer.headers["www-authenticate"].startswith("Bearer")
    assert_problem(guarded.client.get("/api/no-such-thing"), 401, "unauthorized")


@pytest.mark.parametrize(
    "value", ["Bearer", "Basic dTpw", "pct_x", "Bearer pct_" + "a" * 43, "Bearer a b", "Bearer \xe9"]
)
def test_an_invalid_token_is_refused(guarded: Guarded, assert_problem: AssertProblem, value: str) -> None:
    headers = [(b"Authorization", value.encode("latin-1"))]
    assert_problem(guarded.client.get("/api/cell", headers=headers), 401, "unauthorized")


def test_two_tokens_in_one_request_are_refused(guarded: Guarded, assert_problem: AssertProblem) -> None:
    both = [*guarded.headers["viewer"].items(), *guarded.headers["maintainer"].items()]
    assert_problem(guarded.client.get("/api/cell", headers=both), 401, "unauthorized")


@pytest.mark.problem("forbidden")
def test_each_role_reaches_its_routes_only(guarded: Guarded, assert_problem: AssertProblem) -> None:
    """The refusal of an invalid body shows that the request reached its route."""
    cases = (
        ("POST", "/api/scans", "operator", 422),
        ("POST", "/api/calibration/runs", "maintainer", 422),
        ("POST", "/api/calibration/runs/x/activate", "maintainer", 404),
        ("POST", "/api/scans/x/cancel", "viewer", 404),
        ("PUT", "/api/scans/x/keep", "operator", 422),
        ("DELETE", "/api/scans/x", "operator", 404),
        ("GET", "/api/scans/x", "viewer", 404),
    )
    for method, path, min_role, reached in cases:
        for role in ROLES:
            answer = guarded.client.request(method, path, headers=guarded.headers[role], content=b"{")
            if ROLES.index(role) < ROLES.index(min_role):  # type: ignore[arg-type]
                assert min_role in assert_problem(answer, 403, "forbidden")
            else:
                assert answer.status_code == reached, answer.text


def test_a_viewer_cannot_scan_and_an_operator_cannot_acknowledge(
    guarded: Guarded, assert_problem: AssertProblem
) -> None:
    answer = guarded.client.post("/api/scans", json={"mode": "live"}, headers=guarded.headers["viewer"])
    assert_problem(answer, 403, "forbidden")
    answer = guarded.client.post("/api/cell/acknowledge", headers=guarded.headers["operator"])
    assert_problem(answer, 403, "forbidden")
    answer = guarded.client.post("/api/cell/acknowledge", headers=guarded.headers["maintainer"])
    assert_problem(answer, 409, "no-fault")
    assert guarded.client.get("/api/scans", headers=guarded.headers["viewer"]).json()["scans"] == []


def test_head_needs_the_role_of_get(guarded: Guarded) -> None:
    assert guarded.client.head("/api/scans").status_code == 401
    assert guarded.client.head("/api/viewpoints/plan.png", headers=guarded.headers["viewer"]).status_code == 403
    assert guarded.client.head("/api/scans", headers=guarded.headers["viewer"]).status_code == 200
    assert guarded.client.head("/api/cell/stop", headers=guarded.headers["viewer"]).status_code == 405


def test_an_unknown_address_is_not_found_with_a_token(guarded: Guarded, assert_problem: AssertProblem) -> None:
    viewer = guarded.headers["viewer"]
    assert_problem(guarded.client.get("/api/no-such-thing", headers=viewer), 404, "not-found")
    answer = guarded.client.delete("/api/scans", headers=viewer)
    assert_problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == "GET, HEAD, POST"


def test_a_token_is_valid_at_once_and_removed_at_once(guarded: Guarded, assert_problem: AssertProblem) -> None:
    with httpx2.Client(base_url=guarded.client.base_url) as client:  # one connection for all requests
        client.headers.update(bearer(add_token(guarded.data, "guest", "viewer")))
        assert client.get("/api/cell").status_code == 200
        remove_token(guarded.data, "guest")
        assert_problem(client.get("/api/cell"), 401, "unauthorized")
        assert_problem(client.post("/api/cell/stop"), 401, "unauthorized")


@pytest.mark.parametrize("query", ["token={}", "access_token={}", "API_KEY=x", "a=1&key=x", "limit={}", "%74oken=x"])
@pytest.mark.problem("token-in-query")
def test_a_token_in_an_address_is_refused_even_if_it_is_valid(
    guarded: Guarded, assert_problem: AssertProblem, query: str, caplog: pytest.LogCaptureFixture
) -> None:
    token = guarded.headers["viewer"]["Authorization"].split()[1]
    answer = guarded.client.get(f"/api/scans?{query.format(token)}", headers=guarded.headers["viewer"])
    assert_problem(answer, 400, "token-in-query")
    answer = guarded.client.get(f"/api/scans/{token}", headers=guarded.headers["viewer"])
    assert (answer.status_code, answer.json()["type"]) == (400, "urn:pointchain:token-in-query")
    assert token not in answer.text + caplog.text


def test_the_cell_says_who_stopped_the_arm(guarded: Guarded) -> None:
    for role in ("viewer", "operator"):
        stopped = guarded.client.post("/api/cell/stop", headers=guarded.headers[role]).json()
        assert stopped["last_stop"]["by"] == role
    shown = guarded.client.get("/api/cell", headers=guarded.headers["viewer"]).json()
    assert shown["last_stop"] == stopped["last_stop"]


def test_a_viewer_stops_the_arm_while_the_database_is_locked_and_all_threads_are_busy(
    guarded: Guarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop waits for the arm only: neither for the database, nor for a thread, nor for the audit log."""
    busy, robot_answers = [], threading.Event()
    monkeypatch.setattr("cell.control.cell.Cell.connect", lambda *_: (busy.append(1), robot_answers.wait(PATIENCE_S)))
    operator = guarded.headers["operator"]["Authorization"]
    request = f"POST /api/cell/connect HTTP/1.1\r\nHost: localhost\r\nAuthorization: {operator}\r\n\r\n"
    holder = sqlite3.connect(guarded.data / "pointchain.sqlite3", isolation_level=None)
    holder.execute("BEGIN EXCLUSIVE")
    with ExitStack() as connections:
        try:
            for _ in range(THREADS + 5):
                connections.enter_context(connect(port_of(guarded.client))).sendall(request.encode())
            wait_until(lambda: len(busy) == THREADS)
            for _ in range(3):
                # The timeout is shorter than that of the database elsewhere, so a stop that waited for it would fail.
                answer = guarded.client.post("/api/cell/stop", headers=guarded.headers["viewer"], timeout=BUSY_S / 2)
                assert answer.status_code == 200, answer.text
        finally:
            robot_answers.set()
            holder.execute("ROLLBACK")
            holder.close()


def test_without_tokens_a_service_on_all_interfaces_refuses_everyone(
    serve: Serve, tmp_path: Path, assert_problem: AssertProblem
) -> None:
    token = add_token(tmp_path, "a", "maintainer")
    with without_recognition(serve, tmp_path, host="0.0.0.0") as client:  # the test listens on loopback all the same
        assert client.get("/api/cell", headers=bearer(token)).status_code == 200
        remove_token(tmp_path, "a")
        assert_problem(client.get("/api/cell"), 401, "unauthorized")
        assert_problem(client.get("/api/cell", headers=bearer(token)), 401, "unauthorized")


def test_the_description_has_the_minimum_roles() -> None:
    document = create_app(ServiceConfig()).openapi()
    assert document["components"]["securitySchemes"]["token"]["scheme"] == "bearer"
    assert document["paths"]["/api/scans"]["post"]["x-min-role"] == "operator"
    assert {"token": []} in document["paths"]["/api/scans"]["post"]["security"]
    assert document["paths"]["/healthz"]["get"]["security"] == []
