"""Signing in with a browser: the cookie, and the requests for which it does not suffice."""

from collections.abc import Callable, Iterator
from http.cookies import SimpleCookie
from pathlib import Path

import httpx2
import pytest

from service.security.audit.reader import read_audit
from service.security.auth.session_cookie import cookie_name, secret_in_cookie, session_cookie
from service.security.auth.tokens import PREFIX, add_token, remove_token
from tests.service.conftest import Serve
from tests.service.security.conftest import Guarded, without_recognition

AssertProblem = Callable[[httpx2.Response, int, str], str]
CONSOLE_HEADER = {"X-Pointchain": "console"}


def token_of(guarded: Guarded, role: str) -> str:
    return guarded.headers[role]["Authorization"].split()[1]


@pytest.fixture
def browser(guarded: Guarded) -> Iterator[httpx2.Client]:
    """Yield a client that keeps cookies like a browser. It is not signed in."""
    with httpx2.Client(base_url=guarded.client.base_url) as browser:
        yield browser


def sign_in(browser: httpx2.Client, token: str, **headers: str) -> httpx2.Response:
    return browser.post("/api/session", json={"token": token}, headers=headers)


def test_a_browser_signs_in_with_a_token_and_out_again(
    guarded: Guarded, browser: httpx2.Client, assert_problem: AssertProblem
) -> None:
    assert browser.get("/api/session").json() == {"caller": None}
    answer = sign_in(browser, f" {token_of(guarded, 'operator')}\n")  # with the white space of a paste
    session = {"caller": {"name": "operator", "role": "operator", "local": False}}
    assert answer.json() == session == browser.get("/api/session").json()
    assert browser.get("/api/cell").status_code == 200
    assert_problem(browser.post("/api/cell/acknowledge", headers=CONSOLE_HEADER), 403, "forbidden")
    assert browser.delete("/api/session").json() == {"caller": None}
    assert not browser.cookies
    assert_problem(browser.get("/api/cell"), 401, "unauthorized")


def test_the_cookie_is_hidden_from_scripts_and_other_sites(guarded: Guarded, browser: httpx2.Client) -> None:
    header = sign_in(browser, token_of(guarded, "viewer")).headers["set-cookie"]
    (cookie,) = SimpleCookie(header).values()
    assert cookie.key == f"pointchain_{guarded.client.base_url.port}"
    assert (cookie["httponly"], cookie["samesite"], cookie["path"]) == (True, "Strict", "/")
    assert not cookie["secure"]  # a secure cookie would not work in a cell without TLS
    assert not cookie["domain"]
    scope = {"headers": [(b"host", b"cell.example"), (b"origin", b"https://cell.example")]}
    assert "Secure" in session_cookie(scope, "x")


def test_an_invalid_token_does_not_sign_in(
    guarded: Guarded, browser: httpx2.Client, assert_problem: AssertProblem
) -> None:
    for wrong in ("", "x", PREFIX + "a" * 43, token_of(guarded, "viewer")[:-1]):
        answer = sign_in(browser, wrong)
        assert_problem(answer, 401, "unauthorized")
        assert "set-cookie" not in answer.headers
    assert_problem(browser.post("/api/session", json={"token": "x" * 201}), 422, "invalid-request")


def test_the_cookie_alone_cannot_change_anything(
    guarded: Guarded, browser: httpx2.Client, assert_problem: AssertProblem
) -> None:
    """A page of another port of this host is the same site, so its requests carry the cookie too."""
    sign_in(browser, token_of(guarded, "maintainer"))
    origin = str(guarded.client.base_url).rstrip("/")
    for headers in (
        {},
        {"Origin": origin},
        {"Origin": "http://127.0.0.1:1", "X-Pointchain": "x"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "none"},
    ):
        assert_problem(browser.post("/api/cell/acknowledge", headers=headers), 403, "cross-origin")
        assert_problem(browser.request("PUT", "/api/scans/x/keep", headers=headers), 403, "cross-origin")
    for headers in (CONSOLE_HEADER, CONSOLE_HEADER | {"Origin": origin}, {"Sec-Fetch-Site": "same-origin"}):
        # The request reached the cell, which has no fault, or is busy with a request of another test.
        assert browser.post("/api/cell/acknowledge", headers=headers).status_code == 409


def test_a_page_of_another_port_cannot_open_event_streams(
    guarded: Guarded, browser: httpx2.Client, assert_problem: AssertProblem
) -> None:
    sign_in(browser, token_of(guarded, "viewer"))
    assert_problem(browser.get("/api/events"), 403, "cross-origin")
    assert_problem(browser.get("/api/scans/x/events"), 403, "cross-origin")
    with browser.stream("GET", "/api/events", headers=CONSOLE_HEADER) as answer:
        assert answer.status_code == 200
    assert browser.get("/api/scans").status_code == 200  # a link may be followed


def test_a_token_in_the_header_precedes_the_cookie(guarded: Guarded, browser: httpx2.Client) -> None:
    sign_in(browser, token_of(guarded, "maintainer"))
    session = browser.get("/api/session", headers=guarded.headers["viewer"]).json()
    assert session["caller"]["role"] == "viewer"


def test_a_removed_token_is_signed_out_at_once(
    guarded: Guarded, browser: httpx2.Client, assert_problem: AssertProblem
) -> None:
    sign_in(browser, add_token(guarded.data, "guest", "viewer"))
    assert browser.get("/api/cell").status_code == 200
    remove_token(guarded.data, "guest")
    assert_problem(browser.get("/api/cell"), 401, "unauthorized")
    assert_problem(browser.post("/api/cell/stop", headers=CONSOLE_HEADER), 401, "unauthorized")
    assert browser.get("/api/session").json() == {"caller": None}


def test_an_old_cookie_does_not_lock_out_a_local_client(serve: Serve, tmp_path: Path) -> None:
    """The tokens were removed, so that none is needed any more."""
    with without_recognition(serve, tmp_path) as client:
        client.cookies.set(f"pointchain_{client.base_url.port}", PREFIX + "a" * 43)
        assert client.get("/api/session").json() == {"caller": {"name": "local", "role": "maintainer", "local": True}}
        assert client.get("/api/cell").status_code == 200


def test_two_cookies_of_the_same_name_are_ignored(guarded: Guarded) -> None:
    """A page of another port can set a cookie for a longer path, which the browser sends first."""
    name = f"pointchain_{guarded.client.base_url.port}"
    both = f"{name}={token_of(guarded, 'viewer')}; other=1; {name}={token_of(guarded, 'maintainer')}"
    for cookie, known in ((both, False), (both.partition(";")[0], True)):
        session = guarded.client.get("/api/session", headers={"Cookie": cookie}).json()
        assert (session["caller"] is not None) is known


@pytest.mark.parametrize(
    ("host", "name"),
    [("cell", "pointchain"), ("cell:8000", "pointchain_8000"), ("[::1]:80", "pointchain_80"), ("[::1]", "pointchain")],
)
def test_each_port_of_a_host_has_its_own_cookie(host: str, name: str) -> None:
    scope = {"headers": [(b"host", host.encode()), (b"cookie", f"x_{name}=pct_a; {name}=pct_b".encode())]}
    assert cookie_name(scope) == name
    assert secret_in_cookie(scope) == "pct_b"


def test_the_audit_log_has_each_sign_in_without_the_token(
    guarded: Guarded, browser: httpx2.Client, caplog: pytest.LogCaptureFixture
) -> None:
    sign_in(browser, token_of(guarded, "operator"))
    sign_in(browser, "pct_wrong")
    signed = [entry for entry in read_audit(guarded.data, None, None, None, 1000) if entry.what == "POST /api/session"]
    assert ("operator", 200) in [(entry.who, entry.status) for entry in signed]
    assert ("127.0.0.1", 401) in [(entry.who, entry.status) for entry in signed]
    assert token_of(guarded, "operator") not in f"{signed} {caplog.text}"
