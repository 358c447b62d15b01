"""All screens pass the rules of axe, and their buttons are large enough for a tablet."""

from typing import Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.service.conftest import ServedClient
from tests.service.console.conftest import Cell, Open

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes

SERIOUS = ("serious", "critical")
TARGET_PX = 44
"""Minimum height of a touch target. Hints beside a term may be smaller: their text is also shown elsewhere."""


def assert_usable(page: Page) -> None:
    """Assert that axe finds no serious violation, nothing overflows and touch targets are large enough."""
    found = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
    serious = [
        (one["id"], one["help"], [node["html"] for node in one["nodes"]]) for one in found if one["impact"] in SERIOUS
    ]
    assert not serious
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    small = page.evaluate(
        """(minimum) => [...document.querySelectorAll("button:not(.hint), .button, select, nav a")]
            .filter((one) => one.offsetParent !== null && one.offsetHeight < minimum).map((one) => one.outerHTML)""",
        TARGET_PX,
    )
    assert not small


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 768])
def test_every_screen_is_accessible(
    open_console: Open, client: ServedClient, recording: str, scheme: Literal["light", "dark"], width: int
) -> None:
    page = open_console(client, scheme=scheme, width=width).page
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
    assert_usable(page)
    if not client.get("/api/scans?state=succeeded").json()["scans"]:
        page.get_by_label("A recording of an earlier scan").check()
        page.get_by_label("Recording", exact=True).select_option(recording)
        page.get_by_role("button", name="Recognise the recording").click()
        expect(page.get_by_role("link", name="Look at the result")).to_be_visible()
    for key, done in (("2", "The best 5 of"), ("3", "only protected scans"), ("4", "Drift in recent scans")):
        page.keyboard.press(key)
        expect(page.get_by_role("main")).to_contain_text(done)
        if key == "2":
            page.get_by_label("Height map").check()
            page.get_by_role("button", name="fingers").first.click()
            expect(page.get_by_role("main")).to_contain_text("Height above the table")
        if key == "3":
            page.get_by_role("list", name="Scans, the newest first").get_by_role("button").first.click()
        assert_usable(page)


def test_signing_in_and_a_fault_are_accessible(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client).page
    expect(page.get_by_label("Token")).to_be_visible()
    assert_usable(page)
    page = open_console(cell.live.client, token=cell.tokens["maintainer"]).page
    cell.live.is_well()
    cell.live.controller.emergency_stop()
    expect(page.get_by_role("region", name="Fault")).to_be_visible()
    assert_usable(page)
    cell.make_ready()


def test_all_controls_can_be_reached_by_keyboard(open_console: Open, client: ServedClient) -> None:
    page = open_console(client).page
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
    focused = []
    for _ in range(40):
        page.keyboard.press("Tab")
        focused.append(page.evaluate("() => document.activeElement.innerText || document.activeElement.type"))
    assert focused[0].startswith("STOP")  # no link of the bar precedes it
    assert any(one.startswith("Help") for one in focused)
    assert any("Scan: the arm will move" in one for one in focused)
