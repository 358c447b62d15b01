"""Take the manual's pictures of the console, and measure first paint and loaded bytes: `make pictures`."""

import statistics
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.service.console.conftest import ARGUMENTS, chromium_path, wait_until_drawn
from tests.service.service_process import process

FOLDER = Path(__file__).resolve().parents[3] / "docs/images"
SCENE = "overhand-knot"
VISITS = 5
PATIENCE_MS = 120_000


def save_picture(page: Page, name: str) -> None:
    """Save the visible part of the page as a small JPEG."""
    FOLDER.mkdir(exist_ok=True)
    page.screenshot(path=FOLDER / f"console-{name}.jpg", type="jpeg", quality=70)


def scan(page: Page) -> None:
    """Run a live scan and open its result."""
    page.get_by_label("String radius, in mm", exact=True).fill("4.2")
    page.get_by_role("button", name="Scan: the arm will move").click()
    expect(page.get_by_text("5 of 8 views recorded")).to_be_visible()
    page.wait_for_function("() => [...document.images].every((one) => one.complete)")
    save_picture(page, "scan")
    page.get_by_role("link", name="Look at the result").click()
    wait_until_drawn(page)
    page.wait_for_function("() => document.querySelector('.label3d.crossing')")
    save_picture(page, "result")


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
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        data, log = Path(folder) / "data", Path(folder) / "log"
        with process(data, log, POINTCHAIN_CAMERA__SCENE=SCENE) as (_, client):
            address = str(client.base_url)
            size_kb = measure(browser, address)
            page = browser.new_context(viewport={"width": 1280, "height": 800}, locale="en-GB").new_page()
            page.set_default_timeout(PATIENCE_MS)
            page.goto(address)
            scan(page)
            print(f"With a result: {loaded_kb(page) - size_kb:.0f} kB more")
        browser.close()
    for picture in sorted(FOLDER.glob("console-*.jpg")):
        print(f"{picture.name}: {picture.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
