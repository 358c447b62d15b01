"""Fixtures for tests of the console in a real browser with a real service.

Each test checks that the page has no unexpected error and sends requests only to its own service.
"""

import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import httpx2
import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, expect, sync_playwright

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.api.routes.console import BUILT
from service.security.auth.caller import ROLES, Role
from service.security.auth.tokens import add_token
from tests.service.conftest import PATIENCE_S, Serve, ServedClient, wait_until
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
"""Options that render WebGL on the CPU and switch off the browser's own requests."""


def chromium_path() -> str | None:
    """Return the path of the browser; None if none is installed.

    The headless shell is the same engine without a browser's own windows, and takes a third less computing time.
    """
    installed = (shutil.which(name) for name in ("chromium-headless-shell", "chromium", "google-chrome"))
    return os.environ.get("CHROMIUM_PATH") or next(filter(None, installed), None)


# The scope is this package: while Playwright is open, nothing else in this thread can run an event loop.
@pytest.fixture(scope="package")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """The browser. Without one, its tests are skipped; in continuous integration they fail."""
    path = chromium_path()
    if path is None:
        message = (
            "there is no Chromium: install it (Debian: apt-get install chromium-headless-shell), or give its path in "
            "CHROMIUM_PATH"
        )
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    assert (BUILT / "index.html").is_file(), "the console is not built: run `make setup`"
    expect.set_options(timeout=PATIENCE_S * 500)
    # The browser renders on all cores. A low priority keeps it from delaying the arms of other tests.
    wrapper = tmp_path_factory.mktemp("browser") / "chromium"
    wrapper.write_text(f'#!/bin/sh\nexec nice -n 15 {shlex.quote(path)} "$@"\n')
    wrapper.chmod(0o755)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=wrapper, args=ARGUMENTS)
        yield browser
        browser.close()


@dataclass
class Opened:
    """A page with its errors and requests."""

    page: Page
    origin: str
    errors: list[str] = field(default_factory=list)
    requests: list[Request] = field(default_factory=list)
    allowed: list[str] = field(default_factory=list)
    """Patterns of errors that the test provokes."""

    def allow_errors(self, *patterns: str) -> None:
        """Allow errors that match. A browser logs each refused request as an error."""
        self.allowed += patterns

    def check(self) -> None:
        """Assert that no unexpected error occurred and that all requests went to the origin."""
        unexpected = [error for error in self.errors if not any(re.search(known, error) for known in self.allowed)]
        assert not unexpected
        outside = {request.url for request in self.requests if not request.url.startswith(f"{self.origin}/")}
        assert not outside


Open = Callable[..., Opened]
WITHOUT_WEBGL = """
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    return kind === "webgl2" ? null : getContext.call(this, kind, ...rest);
};
"""
Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture
def open_console(chromium: Browser, request: pytest.FixtureRequest) -> Iterator[Open]:
    """Function that opens the page in a new browser context, such as `open_console(client, "#/scan", width=768)`."""
    opened: list[Opened] = []

    def open_page(
        client: httpx2.Client,
        at: str = "",
        token: str | None = None,
        scheme: Literal["light", "dark"] = "light",
        width: int = 1280,
        height: int = 800,
        locale: str = "en-GB",
    ) -> Opened:
        origin = str(client.base_url).rstrip("/")
        context = chromium.new_context(color_scheme=scheme, viewport={"width": width, "height": height}, locale=locale)
        context.set_default_timeout(PATIENCE_S * 500)
        if token is not None:
            answer = context.request.post(f"{origin}/api/session", data={"token": token})
            assert answer.ok, answer.text()
        if request.node.get_closest_marker("without_3d") is not None:
            context.add_init_script(WITHOUT_WEBGL)
        one = Opened(context.new_page(), origin)
        opened.append(one)

        def on_console(message: ConsoleMessage) -> None:
            if message.type in ("error", "assert"):
                one.errors.append(f"{message.text} ({message.location.get('url', '')})")

        def on_request(sent: Request) -> None:
            one.requests.append(sent)

        one.page.on("console", on_console)
        one.page.on("pageerror", lambda error: one.errors.append(f"{error.name}: {error.message}"))
        one.page.on("request", on_request)
        one.page.goto(f"{origin}/{at}")
        return one

    yield open_page
    for one in opened:
        if not one.page.is_closed():
            one.page.unroute_all(behavior="ignoreErrors")  # a handler may wait for an answer that no longer comes
        one.page.context.close()
    for one in opened:
        one.check()


@dataclass(frozen=True)
class Cell:
    """A service with a simulated cell that requires tokens."""

    live: LiveCell
    data: Path
    tokens: dict[Role, str]

    def make_ready(self) -> None:
        """Acknowledge a fault if there is one, and wait until the cell can scan."""
        if self.live.state()["state"] == "fault":
            self.live.controller.reset()
            answer = self.live.client.post("/api/cell/acknowledge")
            assert answer.status_code == 200, answer.text
        self.live.is_well()


@pytest.fixture(scope="package")
def shared_cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell that all tests of the console share, slow enough to catch in motion."""
    data = tmp_path_factory.mktemp("cell")
    tokens: dict[Role, str] = {role: add_token(data, f"an-{role}", role) for role in ROLES}
    with live_cell(serve, data, time_factor=5.0) as live:
        live.client.headers["Authorization"] = f"Bearer {tokens['maintainer']}"
        yield Cell(live, data, tokens)


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Iterator[Cell]:
    """The shared cell. Each test leaves it ready to scan. Its arm is released after the tests of a module."""
    yield shared_cell
    shared_cell.live.release()


@pytest.fixture(scope="package")
def crossed(serve: Serve, finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """A service with one scan, whose string has one crossing."""
    file = tmp_path_factory.mktemp("recording") / "eight.mcap"
    write_simulation(simulate(make_scene("figure-eight", 1), camera_model("exact", (320, 200)), 1, views=6), file)
    with serve(tmp_path_factory.mktemp("data")) as client:
        recording = client.post("/api/recordings", content=file.read_bytes()).json()["id"]
        answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
        assert finished(client, answer.headers["Location"])["summary"]["crossings"] == 1
        yield client


def original_model(crossed: ServedClient) -> dict[str, Any]:
    """Return the model of the oldest scan. The later ones repeat it with other methods."""
    return crossed.get(crossed.get("/api/scans").json()["scans"][-1]["links"]["model"]).json()


def frame_count(page: Page) -> int:
    """Return how many times the 3D view was drawn."""
    return int(page.locator("canvas").get_attribute("data-frames") or 0)


def wait_until_drawn(page: Page) -> None:
    """Wait until the 3D view shows a result with its point cloud."""
    expect(page.locator('canvas[data-points]:not([data-points="0"])')).to_be_visible()
    wait_until(lambda: frame_count(page) > 0)
