"""The host names by which the service may be called, and the pages that may call it."""

import httpx2
import pytest

from service.problems.problem_error import ProblemError
from service.security.auth.allowed_hosts import AllowedHosts, local_address
from service.security.middleware.csrf import check_origin
from tests.service.conftest import ServedClient
from tests.service.security.conftest import connect, port_of, read_all


@pytest.mark.parametrize(
    "host",
    ["localhost", "LocalHost:80", "localhost.", "127.0.0.1:8000", "127.9.9.9", "[::1]", "[::1]:8000", "[0:0::1]"],
)
def test_loopback_names_are_always_allowed(host: str) -> None:
    assert host in AllowedHosts("127.0.0.1", ())


@pytest.mark.parametrize(
    "host",
    [
        "evil.example", "evil.example:8000", "127.0.0.1.evil.example", "localhost.evil.example", "evil-localhost", "",
        "0.0.0.0", "[::]", "192.168.1.5", "127.0.0.1:8000:1", "127.0.0.1:", "127.0.0.1:x", "::1", "[::1",
        "localhost/x", "localhost#", "localhost,evil.example", "2130706433", "0x7f.1", "[::ffff:10.0.0.1]",
        "localhost\n", "l\u043ecalhost", "user@localhost",
    ],
)  # fmt: skip
def test_other_names_are_not_allowed(host: str) -> None:
    assert host not in AllowedHosts("127.0.0.1", ())


def test_the_listen_address_and_configured_names_are_allowed() -> None:
    hosts = AllowedHosts("192.168.1.20", ("cell.local", "FD00::1", "[fd00::2]"))
    for host in ("192.168.1.20:8000", "CELL.local", "cell.local.:80", "[fd00:0::1]:8000", "[fd00::2]", "localhost"):
        assert host in hosts
    assert "192.168.1.21" not in hosts
    assert "0.0.0.0" not in AllowedHosts("0.0.0.0", ("cell.local",))


@pytest.mark.parametrize(
    ("listen_host", "name"),
    [
        ("0.0.0.0", "127.0.0.1"), ("", "127.0.0.1"), ("::", "::1"), ("127.0.0.1", "127.0.0.1"), ("::1", "::1"),
        ("192.168.1.20", "192.168.1.20"), ("cell.local", "cell.local"),
    ],
)  # fmt: skip
def test_the_reported_name_is_allowed(listen_host: str, name: str) -> None:
    assert local_address(listen_host) == name
    assert (f"[{name}]" if ":" in name else name) in AllowedHosts(listen_host, ())


@pytest.mark.problem("host-not-allowed")
def test_a_rebound_name_is_refused(client: ServedClient) -> None:
    for path in ("/api/cell", "/docs", "/healthz"):
        answer = client.get(path, headers={"Host": "evil.example"})
        assert answer.status_code == 421
        assert answer.json()["type"] == "urn:pointchain:host-not-allowed"
        assert answer.json()["instance"] == path
        assert "name or address: add it to security.allowed_hosts" in answer.json()["detail"]
    assert client.get("/api/cell", headers={"Host": "localhost"}).status_code == 200


@pytest.mark.parametrize(
    "head",
    [
        "GET /healthz HTTP/1.1\r\n\r\n",
        "GET /healthz HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n",
        "GET /healthz HTTP/1.0\r\n\r\n",
        "GET http://evil.example/healthz HTTP/1.1\r\nHost: evil.example\r\n\r\n",
    ],
    ids=["none", "two", "old", "absolute"],
)
def test_an_invalid_host_header_is_refused(client: ServedClient, head: str) -> None:
    with connect(port_of(client)) as connection:
        connection.sendall(head.replace("\r\n\r\n", "\r\nConnection: close\r\n\r\n").encode())
        answer = read_all(connection)
    assert answer.startswith((b"HTTP/1.1 400 ", b"HTTP/1.1 421 ")), answer
    assert b"application/problem+json" in answer


OWN_ORIGIN = "http://127.0.0.1:8000"


def check(method: str = "POST", host: str = "127.0.0.1:8000", **headers: str) -> None:
    sent = {"host": host} | {name.replace("_", "-"): value for name, value in headers.items()}
    check_origin({"method": method, "headers": [(name.encode(), value.encode()) for name, value in sent.items()]})


def test_programs_and_own_pages_may_change_things() -> None:
    check()
    check(origin=OWN_ORIGIN, sec_fetch_site="same-origin")
    check(origin=OWN_ORIGIN, x_pointchain="1")
    check(origin=OWN_ORIGIN, authorization="Bearer x")
    check(origin="https://cell.local", host="Cell.local:443", x_pointchain="1")  # behind a TLS proxy
    check(origin="http://[::1]:8000", host="[::1]:8000", x_pointchain="")


@pytest.mark.parametrize("origin", ["null", "http://evil.example", "http://127.0.0.1:9000", "http://127.0.0.1",
                                    "127.0.0.1:8000", "file://", "http://127.0.0.1:8000/x", "http://[", "ftp://127.0.0.1:8000",
                                    "http://127.0.0.1:8000.evil.example", "http://x@127.0.0.1:8000", ""])  # fmt: skip
def test_another_origin_is_refused_with_any_header(origin: str) -> None:
    with pytest.raises(ProblemError, match="another origin"):
        check(origin=origin, x_pointchain="1", sec_fetch_site="same-origin")


def test_headers_that_any_page_can_send_do_not_suffice() -> None:
    with pytest.raises(ProblemError, match="X-Pointchain"):
        check(origin=OWN_ORIGIN)
    for site in ("cross-site", "same-site"):
        for headers in ({}, {"x_pointchain": "1"}, {"origin": OWN_ORIGIN, "x_pointchain": "1"}):
            with pytest.raises(ProblemError):
                check(sec_fetch_site=site, **headers)
        with pytest.raises(ProblemError):
            check("GET", sec_fetch_site=site, sec_fetch_mode="no-cors")
        check("GET", sec_fetch_site=site, sec_fetch_mode="navigate")  # a person follows a link


@pytest.mark.problem("cross-origin")
def test_a_cross_origin_post_is_refused_and_a_preflight_gets_no_permission(client: ServedClient) -> None:
    before = client.get("/api/scans").json()
    simple = {"Origin": "http://evil.example", "Content-Type": "text/plain"}
    answer = client.post("/api/scans", content=b'{"mode": "live"}', headers=simple)
    assert (answer.status_code, answer.json()["type"]) == (403, "urn:pointchain:cross-origin")
    requested = {"Origin": "http://evil.example", "Access-Control-Request-Method": "POST"}
    preflight = client.options("/api/scans", headers=requested)
    assert preflight.status_code == 405
    for one in (answer, preflight, client.get("/api/cell", headers={"Origin": "http://evil.example"})):
        assert not [name for name in one.headers if name.startswith("access-control-")]
    assert client.get("/api/scans").json() == before


def test_the_page_of_the_api_can_send_requests(client: ServedClient) -> None:
    """Browsers send Sec-Fetch-* on loopback, but not elsewhere over plain HTTP."""
    origin = str(client.base_url).rstrip("/")
    page = client.get("/docs")
    assert "<script>" not in page.text  # its content policy forbids inline scripts
    script = client.get("/docs/start.js")
    assert script.headers["content-type"].startswith("text/javascript")
    assert 'request.headers["X-Pointchain"]' in script.text
    fetched = {"Origin": origin, "Sec-Fetch-Site": "same-origin", "Sec-Fetch-Mode": "cors"}
    for headers in (fetched, {"Origin": origin, "X-Pointchain": "docs"}):
        answer: httpx2.Response = client.post("/api/viewpoints/plan", headers=headers, json={"views": 99})
        assert answer.status_code == 422, answer.text  # the request reached the route
