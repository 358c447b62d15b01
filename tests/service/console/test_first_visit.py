"""The first visit to the page, and the files that it loads."""

from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest
from playwright.sync_api import expect

from service.api.routes import console
from tests.service.conftest import Serve, ServedClient
from tests.service.console.conftest import Open
from tests.service.security.conftest import without_recognition

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]


def test_the_page_shows_the_cell_state_without_a_token(open_console: Open, client: ServedClient) -> None:
    page = open_console(client).page
    expect(page.get_by_role("banner").get_by_role("status")).to_contain_text("Not ready")
    expect(page.get_by_role("banner").get_by_role("status")).to_contain_text("Not connected yet")
    expect(page.get_by_role("button", name="STOP the arm")).to_be_enabled()
    expect(page.get_by_text("This machine: all rights")).to_be_visible()
    expect(page.get_by_role("banner").get_by_text("Live", exact=True)).to_be_visible()


def test_each_screen_has_an_address_and_a_key(open_console: Open, client: ServedClient) -> None:
    page = open_console(client, "#/history").page
    expect(page.get_by_role("heading", name="History", level=1)).to_be_visible()
    for key, name in (("4", "Calibration"), ("1", "Scan"), ("3", "History")):
        page.keyboard.press(key)
        expect(page.get_by_role("link", name=name, exact=False).locator("xpath=self::*[@aria-current]")).to_be_visible()
        expect(page.get_by_role("heading", name=name, level=1)).to_be_visible()


def test_the_files_come_from_the_service_and_are_revalidated(client: ServedClient) -> None:
    page = client.get("/")
    assert page.headers["content-type"].startswith("text/html")
    assert "script-src" not in page.headers["content-security-policy"]
    assert client.head("/").status_code == 200
    named = [part.split('"')[0] for part in page.text.split('="/console/')[1:]]
    assert {"main.js", "stop.js", "main.css", "icon.svg"} <= set(named)
    for name in named:
        answer = client.get(f"/console/{name}")
        assert answer.status_code == 200, name
        assert answer.headers["cache-control"] == "no-cache"
        again = client.get(f"/console/{name}", headers={"If-None-Match": answer.headers["etag"]})
        assert again.status_code == 304


def test_files_are_sent_compressed_to_clients_that_can_read_it(client: ServedClient) -> None:
    for name in ("main.js", "main.css"):
        compressed = client.get(f"/console/{name}", headers={"Accept-Encoding": "gzip"})
        plain = client.get(f"/console/{name}", headers={"Accept-Encoding": "identity"})
        assert (compressed.headers["content-encoding"], "content-encoding" in plain.headers) == ("gzip", False)
        assert compressed.content == plain.content  # as decoded
        assert compressed.headers["content-type"] == plain.headers["content-type"]
        assert int(compressed.headers["content-length"]) < len(plain.content) / 2
        assert compressed.headers["vary"] == plain.headers["vary"] == "Accept-Encoding"
        assert compressed.headers["etag"] != plain.headers["etag"]
        known = {"Accept-Encoding": "gzip", "If-None-Match": compressed.headers["etag"]}
        assert client.get(f"/console/{name}", headers=known).status_code == 304


def test_only_built_files_are_served(
    client: ServedClient, assert_problem: Callable[[httpx2.Response, int, str], str]
) -> None:
    for path in ("/console/none.js", "/console/../web/package.json", "/console/%2e%2e/__init__.py", "/console/"):
        assert_problem(client.get(path), 404, "not-found")


@pytest.mark.problem("console-not-built")
def test_the_api_works_without_a_built_console(
    serve: Serve,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    assert_problem: Callable[[httpx2.Response, int, str], str],
) -> None:
    monkeypatch.setattr(console.FILES, "all_directories", [tmp_path / "none"])
    with without_recognition(serve, tmp_path) as client:
        assert "make setup" in assert_problem(client.get("/"), 503, "console-not-built")
        assert client.get("/api/cell").status_code == 200
