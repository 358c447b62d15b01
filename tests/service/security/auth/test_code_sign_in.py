"""Signing a browser in with a code over HTTP: the session, its end, and the limit of wrong codes."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from itertools import islice
from pathlib import Path
from typing import Any

import httpx2
import pytest

from service.api import server_sent_events
from service.clock import utc_now
from service.problems.problem_error import ProblemError
from service.security.audit.reader import read_audit
from service.security.auth import code_sign_in
from service.security.auth.code_sign_in import MAX_WRONG_CODES, WINDOW_S, WrongCodeLimit
from service.security.auth.sessions import SESSION_LIFETIME, SESSIONS_FILE, add_code, read_sessions
from service.security.auth.tokens import add_token, remove_token
from tests.service.conftest import PATIENCE_S, Serve, ServedClient
from tests.service.faults.full_disk import full_disk
from tests.service.security.conftest import bearer, without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]
CONSOLE_HEADER = {"X-Pointchain": "console"}
NO_CODE = "ZZZZ-ZZZZ"
"""A code that is not valid."""


@dataclass(frozen=True)
class Service:
    """A service with the operator ann, with a limit of its own on wrong codes."""

    data: Path
    client: ServedClient
    token: str

    def code(self, minutes: int = 10) -> str:
        """Make a code for ann."""
        return add_code(self.data, "ann", minutes, utc_now()).code

    def browser(self) -> httpx2.Client:
        """Return a client that keeps cookies like a browser. It is not signed in."""
        return httpx2.Client(base_url=self.client.base_url, timeout=PATIENCE_S)


@pytest.fixture
def service(serve: Serve, tmp_path: Path) -> Iterator[Service]:
    add_token(tmp_path, "bob", "viewer")  # without any token, a client on this machine would need none
    token = add_token(tmp_path, "ann", "operator")
    with without_recognition(serve, tmp_path) as client:
        yield Service(tmp_path, client, token)


def sign_in(browser: httpx2.Client, code: str) -> httpx2.Response:
    return browser.post("/api/session", json={"code": code})


def test_a_code_signs_in_without_the_token(service: Service) -> None:
    code = service.code()
    with service.browser() as browser:
        answer = sign_in(browser, f" {code.lower().replace('-', ' ')}")
        session = {"caller": {"name": "ann", "role": "operator", "local": False}}
        assert answer.json() == session == browser.get("/api/session").json()
        assert browser.get("/api/cell").status_code == 200
        assert browser.post("/api/cell/stop", headers=CONSOLE_HEADER).status_code == 200
        (secret,) = browser.cookies.values()
    header = answer.headers["set-cookie"]
    assert f"Max-Age={int(SESSION_LIFETIME.total_seconds())}" in header
    assert "HttpOnly" in header
    assert "SameSite=Strict" in header
    assert service.token not in header
    # the session is for a cookie only: it is neither a token nor to be sent in an address
    assert service.client.get("/api/cell", headers=bearer(secret)).status_code == 401
    assert service.client.post("/api/session", json={"token": secret}).status_code == 401
    assert service.client.get(f"/api/scans?x={secret}").json()["type"] == "urn:pointchain:token-in-query"


def test_wrong_used_and_expired_codes_have_the_same_answer(service: Service, assert_problem: AssertProblem) -> None:
    used, browser = service.code(), service.browser()
    assert sign_in(browser, used).status_code == 200
    expired = add_code(service.data, "ann", 1, utc_now() - timedelta(minutes=2)).code
    answers = [sign_in(service.client, code) for code in (used, expired, NO_CODE, "x", "")]
    details = {assert_problem(answer, 401, "unauthorized") for answer in answers}
    assert details == {"this code is wrong, was used, or has expired: make a new one with `pointchain token code NAME`"}
    assert not [answer for answer in answers if "set-cookie" in answer.headers]
    browser.close()


@pytest.mark.parametrize(
    ("body", "where"),
    [
        ({}, "body: either token or code is needed, and not both"),
        ([], "body: either token or code is needed, and not both"),
        ("code", "body: either token or code is needed, and not both"),
        ({"code": "A", "token": "B"}, "body: either token or code is needed, and not both"),
        ({"code": 12345678}, "body.code: "),
        ({"code": "A" * 101}, "body.code: "),
        ({"code": "A", "more": 1}, "body.more: there is no such member"),
        ({"token": None}, "body.token: "),
    ],
)
def test_the_body_has_either_a_code_or_a_token(
    client: ServedClient, assert_problem: AssertProblem, body: Any, where: str
) -> None:
    detail = assert_problem(client.post("/api/session", json=body), 422, "invalid-request")
    assert detail.startswith(where)
    assert ";" not in detail, "one cause has one message"


def test_of_simultaneous_sign_ins_exactly_one_succeeds(service: Service) -> None:
    code, begin = service.code(), threading.Barrier(4)

    def use(_: int) -> int:
        with service.browser() as browser:
            begin.wait()
            return sign_in(browser, code).status_code

    with ThreadPoolExecutor(4) as pool:
        assert sorted(pool.map(use, range(4))) == [200, 401, 401, 401]


def test_removing_the_token_ends_its_sessions_and_their_streams(
    service: Service, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server_sent_events, "PING_S", 0.05)
    with service.browser() as browser:
        sign_in(browser, service.code())
        with browser.stream("GET", "/api/events", headers=CONSOLE_HEADER) as stream:
            assert stream.status_code == 200
            remove_token(service.data, "ann")
            assert len(list(islice(stream.iter_lines(), 1000))) < 1000, "the stream does not end"
        add_token(service.data, "ann", "maintainer")  # another token of the same name
        assert_problem(browser.get("/api/cell"), 401, "unauthorized")
        assert_problem(browser.post("/api/cell/stop", headers=CONSOLE_HEADER), 401, "unauthorized")
        assert browser.get("/api/session").json() == {"caller": None}


def test_an_expired_session_is_refused(
    service: Service, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    with service.browser() as browser:
        sign_in(browser, service.code())
        later = utc_now() + SESSION_LIFETIME
        monkeypatch.setattr("service.security.auth.authentication.utc_now", lambda: later)
        assert_problem(browser.get("/api/cell"), 401, "unauthorized")


def test_signing_out_ends_the_session(service: Service, assert_problem: AssertProblem) -> None:
    with service.browser() as browser, service.browser() as copied:
        sign_in(browser, service.code())
        copied.cookies.update(browser.cookies)
        assert copied.get("/api/cell").status_code == 200
        assert browser.delete("/api/session").json() == {"caller": None}
        assert not browser.cookies
        assert_problem(copied.get("/api/cell"), 401, "unauthorized")
    assert service.client.get("/api/cell", headers=bearer(service.token)).status_code == 200


def test_another_sign_in_ends_the_earlier_session_of_the_browser(service: Service) -> None:
    file = service.data / SESSIONS_FILE
    with service.browser() as browser:
        for _ in range(2):
            assert sign_in(browser, service.code()).status_code == 200
            assert len(read_sessions(file).sessions) == 1
        assert sign_in(browser, NO_CODE).status_code == 401
        assert browser.get("/api/cell").status_code == 200  # a wrong code ends nothing
        assert browser.post("/api/session", json={"token": service.token}).status_code == 200
        assert read_sessions(file).sessions == ()
        assert browser.get("/api/cell").status_code == 200


def test_the_cookie_of_a_session_cannot_change_anything_alone(service: Service, assert_problem: AssertProblem) -> None:
    with service.browser() as browser:
        sign_in(browser, service.code())
        assert_problem(browser.post("/api/cell/connect"), 403, "cross-origin")
        assert_problem(browser.get("/api/events"), 403, "cross-origin")


@pytest.mark.problem("too-many-wrong-codes")
def test_wrong_codes_are_limited_but_tokens_and_stops_are_not(service: Service, assert_problem: AssertProblem) -> None:
    code = service.code()
    for _ in range(MAX_WRONG_CODES):
        assert_problem(sign_in(service.client, NO_CODE), 401, "unauthorized")
    for refused in (NO_CODE, code):  # the answer says nothing about the code
        answer = sign_in(service.client, refused)
        assert "or sign in with a token" in assert_problem(answer, 429, "too-many-wrong-codes")
        assert 0 < int(answer.headers["retry-after"]) <= WINDOW_S
    with service.browser() as browser:
        assert browser.post("/api/session", json={"token": service.token}).status_code == 200
        assert browser.post("/api/cell/stop", headers=CONSOLE_HEADER).status_code == 200
    service.client.app.state.code_sign_in._limit._attempts.clear()  # the minute is over
    assert sign_in(service.client, code).status_code == 200


def test_right_codes_do_not_count_and_simultaneous_wrong_ones_do(service: Service) -> None:
    for _ in range(MAX_WRONG_CODES + 1):
        with service.browser() as browser:
            assert sign_in(browser, service.code()).status_code == 200

    def guess(_: int) -> int:
        with service.browser() as browser:
            return sign_in(browser, NO_CODE).status_code

    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(guess, range(2 * MAX_WRONG_CODES)))
    assert sorted(answers) == [401] * MAX_WRONG_CODES + [429] * MAX_WRONG_CODES


def test_the_limit_is_that_of_one_minute() -> None:
    now_s = 1000.0
    limit = WrongCodeLimit(lambda: now_s)
    for _ in range(MAX_WRONG_CODES):
        limit.begin()
        now_s += 1.0
    with pytest.raises(ProblemError) as refused:
        limit.begin()
    assert refused.value.headers == {"Retry-After": str(int(WINDOW_S) - MAX_WRONG_CODES)}
    now_s = 1000.0 + WINDOW_S
    limit.begin()
    with pytest.raises(ProblemError):
        limit.begin()


def test_the_audit_log_names_the_caller_and_the_code(service: Service) -> None:
    code = service.code()
    sign_in(service.client, code)
    for _ in range(3):
        sign_in(service.client, NO_CODE)
    found = [entry for entry in read_audit(service.data, None, None, None, 100) if "session" in entry.what]
    assert [(entry.who, entry.role, entry.what, entry.status) for entry in found] == [
        ("ann", "operator", "POST /api/session (with a code)", 200),
        ("127.0.0.1", "none", "POST /api/session (with a code)", 401),
    ]
    assert code not in f"{found}"


@pytest.mark.problem("damaged")
def test_a_damaged_file_refuses_codes_and_keeps_tokens(
    service: Service, assert_problem: AssertProblem, caplog: pytest.LogCaptureFixture
) -> None:
    code = service.code()
    (service.data / SESSIONS_FILE).write_text("{")
    detail = assert_problem(sign_in(service.client, code), 500, "damaged")
    assert "sign in with a token" in detail
    assert str(service.data) not in detail
    assert f"{service.data / SESSIONS_FILE} is damaged" in caplog.text
    assert service.client.get("/api/cell", headers=bearer(service.token)).status_code == 200
    assert "sessions.json is damaged" in service.client.get("/readyz").json()["detail"]


def test_a_full_disk_is_reported_and_the_code_stays_valid(
    service: Service, assert_problem: AssertProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = service.code()
    with service.browser() as browser, monkeypatch.context() as patch:
        disk = full_disk(patch)
        disk.fill(1)
        assert_problem(sign_in(browser, code), 507, "storage-full")
        disk.clear()
        assert sign_in(browser, code).status_code == 200
        disk.fill(1)
        assert browser.delete("/api/session").status_code == 200  # the browser forgets it, whatever the disk does
        assert not browser.cookies
        disk.clear()


def test_a_stop_does_not_wait_for_a_sign_in(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def wait(*_: object) -> None:
        begun.set()
        assert go_on.wait(PATIENCE_S)

    monkeypatch.setattr(code_sign_in, "redeem_code", wait)
    with ThreadPoolExecutor(60) as pool:
        waiting = [pool.submit(sign_in, service.client, NO_CODE) for _ in range(60)]  # more than there are threads
        try:
            assert begun.wait(PATIENCE_S)
            headers = bearer(service.token)
            assert service.client.post("/api/cell/stop", headers=headers, timeout=5).status_code == 200
            assert service.client.get("/api/scans", headers=headers, timeout=5).status_code == 200
        finally:
            go_on.set()
        assert {answer.result().status_code for answer in waiting} == {401, 429}
