"""The console in a real browser, with a real service.

In each test, the page has no error that the test does not name, and sends requests only to its own service.
"""

import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import httpx2
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, expect, sync_playwright

from service.api.routes.console import BUILT
from service.security.auth.caller import ROLES, Role
from service.security.auth.tokens import add_token
from tests.service.conftest import PATIENCE_S, Serve, wait_until
from tests.service.live_cell import LiveCell, live_cell

ARGUMENTS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
"""Draws WebGL by the processor, and has the browser ask for nothing of its own accord."""


def chromium_path() -> str | None:
    """Where the browser is, if there is one."""
    return os.environ.get("POINTCHAIN_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")


# Not for longer than a module's tests: as long as it is open, nothing else in this thread can run an event loop.
@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """The browser. Where there is none, its tests are skipped; not so in continuous integration."""
    path = chromium_path()
    if path is None:
        missing = (
            "there is no Chromium: install it (Debian: apt-get install chromium), or name it in POINTCHAIN_CHROMIUM"
        )
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)
    assert (BUILT / "index.html").is_file(), "the console is not built: run `make setup`"
    expect.set_options(timeout=PATIENCE_S * 500)
    # It draws by the processor, with as many threads as there are cores: after all else, so that no arm that another
    # test moves falls silent.
    last = tmp_path_factory.mktemp("browser") / "chromium"
    last.write_text(f'#!/bin/sh\nexec nice -n 15 {shlex.quote(path)} "$@"\n')
    last.chmod(0o755)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=last, args=ARGUMENTS)
        yield browser
        browser.close()


@dataclass
class Opened:
    """A page, and what it did."""

    page: Page
    origin: str
    errors: list[str] = field(default_factory=list)
    requests: list[Request] = field(default_factory=list)
    expected: list[str] = field(default_factory=list)

    def expect(self, *patterns: str) -> None:
        """Errors that match are what the test is about: a browser tells each refusal as one."""
        self.expected += patterns

    def judge(self) -> None:
        """Nothing went wrong, and nothing left the origin."""
        unexpected = [error for error in self.errors if not any(re.search(known, error) for known in self.expected)]
        assert not unexpected
        outside = {request.url for request in self.requests if not request.url.startswith(f"{self.origin}/")}
        assert not outside


Open = Callable[..., Opened]


@pytest.fixture
def open_console(chromium: Browser) -> Iterator[Open]:
    """`open_console(client, "#/scan", token=..., scheme="dark", width=768)`: the page in a browser of its own."""
    opened: list[Opened] = []

    def open_page(
        client: httpx2.Client,
        at: str = "",
        token: str | None = None,
        scheme: Literal["light", "dark"] = "light",
        width: int = 1280,
        locale: str = "en-GB",
    ) -> Opened:
        origin = str(client.base_url).rstrip("/")
        context = chromium.new_context(color_scheme=scheme, viewport={"width": width, "height": 800}, locale=locale)
        context.set_default_timeout(PATIENCE_S * 500)
        if token is not None:
            answer = context.request.post(f"{origin}/api/session", data={"token": token})
            assert answer.ok, answer.text()
        one = Opened(context.new_page(), origin)
        opened.append(one)

        def told(message: ConsoleMessage) -> None:
            if message.type in ("error", "assert"):
                one.errors.append(f"{message.text} ({message.location.get('url', '')})")

        def asked(request: Request) -> None:
            one.requests.append(request)

        one.page.on("console", told)
        one.page.on("pageerror", lambda error: one.errors.append(f"{error.name}: {error.message}"))
        one.page.on("request", asked)
        one.page.goto(f"{origin}/{at}")
        return one

    yield open_page
    for one in opened:
        one.page.context.close()
    for one in opened:
        one.judge()


@dataclass(frozen=True)
class Cell:
    """A simulated cell behind a service that asks for tokens."""

    live: LiveCell
    data: Path
    tokens: dict[Role, str]

    def is_well(self) -> None:
        """Has the arm stand free and the cell able to scan again."""
        if self.live.state()["state"] == "fault":
            self.live.controller.reset()
            answer = self.live.client.post("/api/cell/acknowledge")
            assert answer.status_code == 200, answer.text
        self.live.is_well()


@pytest.fixture(scope="package")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """One for all tests of this folder, slow enough to be caught in motion; each leaves it able to scan."""
    data = tmp_path_factory.mktemp("cell")
    tokens: dict[Role, str] = {role: add_token(data, f"an-{role}", role) for role in ROLES}
    with live_cell(serve, data, time_factor=5.0) as live:
        live.client.headers["Authorization"] = f"Bearer {tokens['maintainer']}"
        yield Cell(live, data, tokens)


def frames(page: Page) -> int:
    """How often the 3D view was drawn so far."""
    return int(page.locator("canvas").get_attribute("data-frames") or 0)


def drawn(page: Page) -> None:
    """Waits until a result is there in 3D, with its cloud."""
    expect(page.locator('canvas[data-points]:not([data-points="0"])')).to_be_visible()
    wait_until(lambda: frames(page) > 0)
