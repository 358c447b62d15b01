"""Take pictures of the console, and measure first paint and loaded bytes: `make pictures`.

The manual's pictures are written to `docs/images`. All main states, on a phone, a tablet and a desktop, light and dark,
are written to `build/pictures`, for people to look at. Each state must pass the rules of axe, and no text may be cut or
covered.
"""

import os
import signal
import statistics
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import httpx2
from playwright.sync_api import Browser, Page, expect, sync_playwright

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from cell.simulation.ur_controller.admin_client import AdminClient
from service.security.auth.tokens import add_token
from tests.cell.loopback import free_host
from tests.service.conftest import wait_until
from tests.service.console.boxes import assert_texts_fit
from tests.service.console.conftest import ARGUMENTS, chromium_path, wait_until_drawn
from tests.service.console.test_accessibility import assert_usable
from tests.service.service_process import process

ROOT = Path(__file__).resolve().parents[3]
MANUAL, STATES = ROOT / "docs/images", ROOT / "build/pictures"
SCENE = "overhand-knot"
SIZES = {"phone": (390, 844), "tablet": (1024, 768), "desktop": (1920, 1080)}
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
VISITS = 5
PATIENCE_MS = 120_000


def wait_for_images(page: Page) -> None:
    """Wait until all images are loaded and the 3D view is drawn."""
    page.wait_for_function("() => [...document.images].every((one) => one.complete)")
    page.wait_for_timeout(500)


def scan_for_the_manual(page: Page) -> None:
    """Run a live scan, open its result, and save the pictures of both."""

    def save(name: str) -> None:
        wait_for_images(page)
        page.screenshot(path=MANUAL / f"console-{name}.jpg", type="jpeg", quality=70)

    page.get_by_label("String radius, in mm", exact=True).fill("4.2")
    page.get_by_role("button", name="Scan: the arm will move").click()
    expect(page.get_by_text("5 of 8 views recorded")).to_be_visible()
    save("scan")
    page.get_by_role("link", name="Look at the result").click()
    wait_until_drawn(page)
    page.wait_for_function("() => document.querySelector('.label3d.crossing')")
    save("result")


class States:
    """Opens the console in one size and one colour scheme, and saves a picture of each main state."""

    def __init__(self, browser: Browser, address: str, size: str, scheme: Literal["light", "dark"]) -> None:
        self._browser, self._address = browser, address
        self._size = size
        self._scheme: Literal["light", "dark"] = scheme
        self._count = 0
        self.faults: list[str] = []
        """What is wrong in the pictures, with the name of each."""

    @contextmanager
    def page(self, token: str | None) -> Iterator[Page]:
        """Open a page that is signed in with a token, or not at all."""
        width, height = SIZES[self._size]
        context = self._browser.new_context(
            color_scheme=self._scheme, viewport={"width": width, "height": height}, locale="en-GB"
        )
        context.set_default_timeout(PATIENCE_MS)
        if token is not None:
            answer = context.request.post(f"{self._address}/api/session", data={"token": token})
            assert answer.ok, answer.text()
        page = context.new_page()
        page.goto(self._address)
        yield page
        context.close()

    def save(self, page: Page, name: str) -> None:
        """Save the visible part of the page, and check the whole page."""
        wait_for_images(page)
        self._count += 1
        file = f"{self._size}-{self._scheme}-{self._count:02}-{name}.png"
        page.screenshot(path=STATES / file)
        for check in (assert_usable, assert_texts_fit):
            try:
                check(page)
            except AssertionError as error:
                self.faults.append(f"{file}: {error}")


def save_states(
    states: States,
    cell: httpx2.Client,
    service: int,
    controller: AdminClient,
    tokens: dict[str, str],
    doubtful: str,
) -> None:
    """Bring the cell into each main state, and save a picture of it.

    Args:
        states: Saves the pictures.
        cell: Client of the service, with the rights of a maintainer.
        service: Process id of the service.
        controller: Admin client of the virtual controller.
        tokens: Tokens by role.
        doubtful: Id of a scan with a doubt.
    """
    with states.page(None) as page:
        expect(page.get_by_label("Token")).to_be_visible()
        states.save(page, "sign-in")
    with states.page(tokens["viewer"]) as page:
        expect(page.get_by_text("Only operators start scans")).to_be_visible()
        states.save(page, "viewer")
    with states.page(tokens["maintainer"]) as page:
        expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
        states.save(page, "first-visit")
        page.get_by_label("String radius, in mm", exact=True).fill("4.2")
        page.get_by_role("button", name="Scan: the arm will move").click()
        expect(page.get_by_text("4 of 8 views recorded")).to_be_visible()
        states.save(page, "scanning")
        look = page.get_by_role("region", name="The last scan").get_by_role("link", name="Look at the result")
        expect(look).to_be_visible()
        states.save(page, "scan-ended")
        look.click()
        wait_until_drawn(page)
        states.save(page, "result")
        page.keyboard.press("1")
        page.get_by_role("button", name="STOP the arm").click()
        expect(page.get_by_role("region", name="After a stop")).to_be_visible()
        states.save(page, "stopped")

        page.goto(f"{page.url.partition('#')[0]}#/result/{doubtful}")
        wait_until_drawn(page)
        states.save(page, "result-with-doubts")
        page.keyboard.press("3")
        page.get_by_role("list", name="Scans, the newest first").get_by_role("button").first.click()
        states.save(page, "history")
        page.keyboard.press("4")
        expect(page.get_by_role("main")).to_contain_text("Drift in recent scans")
        states.save(page, "calibration")

        page.keyboard.press("1")
        assert cell.post("/api/cell/connect").is_success
        controller.emergency_stop()
        expect(page.get_by_role("region", name="Fault")).to_be_visible()
        states.save(page, "fault")
        os.kill(service, signal.SIGSTOP)
        expect(page.get_by_role("banner")).to_contain_text("State unknown: no connection")
        states.save(page, "lost-service")
        os.kill(service, signal.SIGCONT)
        controller.reset()
        assert cell.post("/api/cell/acknowledge").is_success
        expect(page.get_by_text("acknowledged the fault at")).to_be_visible()
        states.save(page, "acknowledged")


def doubtful_scan(cell: httpx2.Client, file: Path) -> str:
    """Recognise two views of a knot, in which a doubt remains. Return the id of the scan.

    Args:
        cell: Client of the service.
        file: Path of the recording that is made.
    """
    write_simulation(simulate(make_scene(SCENE, 2), camera_model("ideal"), 2, views=2), file)
    recording = cell.post("/api/recordings?name=two-views.mcap", content=file.read_bytes()).json()["id"]
    scan = cell.post("/api/scans", json={"mode": "replay", "recording": recording}).json()
    wait_until(lambda: cell.get(scan["links"]["self"]).json()["final"])
    scan = cell.get(scan["links"]["self"]).json()
    assert scan["summary"]["doubts"], scan
    return scan["id"]


def loaded_kb(page: Page) -> float:
    """Return the transferred size of the console's files, in kB."""
    return page.evaluate(
        """() => performance.getEntriesByType("resource").filter((one) => one.name.includes("/console/"))
            .reduce((sum, one) => sum + one.encodedBodySize, 0) / 1000"""
    )


def measure(browser: Browser, address: str) -> float:
    """Print the time of the first paint and the size loaded by then; return that size in kB."""
    paints, size_kb = [], 0.0
    for _ in range(VISITS):
        page = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
        page.goto(address)
        expect(page.get_by_role("banner").get_by_role("status")).to_be_visible()
        # A visible element may not be painted yet.
        first = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime"
        paints.append(page.wait_for_function(first).json_value())
        size_kb = loaded_kb(page)
        page.context.close()
    print(
        f"First paint: {statistics.median(paints):.0f} ms, median of {VISITS} first visits ({max(paints):.0f} at most)"
    )
    print(f"Loaded by then: {size_kb:.0f} kB")
    return size_kb


def main() -> int:
    """Take the pictures; return the exit status."""
    path = chromium_path()
    if path is None:
        print("there is no Chromium: install it, or name it in CHROMIUM_PATH", file=sys.stderr)
        return 1
    expect.set_options(timeout=PATIENCE_MS)
    STATES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        data, log, host = Path(folder) / "data", Path(folder) / "log", free_host()
        variables = {
            "POINTCHAIN_CAMERA__MODEL": "ideal",
            "POINTCHAIN_CAMERA__SCENE": SCENE,
            "POINTCHAIN_ARM__HOST": host,
        }
        with process(data, log, **variables) as (running, client):
            address = str(client.base_url)
            size_kb = measure(browser, address)
            page = browser.new_context(viewport={"width": 1280, "height": 800}, locale="en-GB").new_page()
            page.set_default_timeout(PATIENCE_MS)
            page.goto(address)
            scan_for_the_manual(page)
            print(f"With a result: {loaded_kb(page) - size_kb:.0f} kB more")
            page.context.close()
            tokens = {role: add_token(data, role, role) for role in ("viewer", "maintainer")}
            client.headers["Authorization"] = f"Bearer {tokens['maintainer']}"
            controller = AdminClient(host)
            doubtful = doubtful_scan(client, Path(folder) / "two-views.mcap")
            faults = []
            for size in SIZES:
                for scheme in SCHEMES:
                    states = States(browser, address, size, scheme)
                    save_states(states, client, running.pid, controller, tokens, doubtful)
                    faults += states.faults
            controller.close()
        browser.close()
    for picture in sorted(MANUAL.glob("console-*.jpg")):
        print(f"{picture.name}: {picture.stat().st_size / 1000:.0f} kB")
    print(f"{len(list(STATES.glob('*.png')))} pictures of states in {STATES.relative_to(ROOT)}")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
