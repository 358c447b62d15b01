"""The manual in a browser, and the console's links to it."""

from typing import Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from service.api.routes.manual import START
from service.security.middleware.headers import MANUAL_FOLDER
from tests.service.conftest import ServedClient
from tests.service.console.conftest import Cell, Open

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]

SERIOUS = ("serious", "critical")


@pytest.fixture(scope="module", autouse=True)
def manual_is_built() -> None:
    assert (MANUAL_FOLDER / START).is_file(), "the manual is not built: run `make setup`"


def test_the_manual_opens_without_an_error(open_console: Open, client: ServedClient) -> None:
    """The fixture checks that the content policy blocks nothing and that no request leaves the service."""
    page = open_console(client, "manual/").page
    expect(page.get_by_role("heading", level=1)).to_be_visible()
    expect(page.locator("body")).to_have_attribute("data-theme", "auto")  # set by the script inside the page
    page.get_by_role("button", name="Toggle Light / Dark / Auto color theme").locator("visible=true").click()
    expect(page.locator("body")).not_to_have_attribute("data-theme", "auto")


def test_the_manual_follows_the_colour_scheme(open_console: Open, client: ServedClient) -> None:
    def brightness(scheme: Literal["light", "dark"]) -> float:
        page = open_console(client, "manual/", scheme=scheme).page
        colour = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
        return sum(map(float, colour[colour.index("(") + 1 : -1].split(",")[:3])) / 3

    assert brightness("light") > 200
    assert brightness("dark") < 60


def test_the_search_finds_a_page(open_console: Open, client: ServedClient) -> None:
    page = open_console(client, "manual/").page
    page.get_by_role("textbox", name="Search").locator("visible=true").fill("protective stop")
    page.keyboard.press("Enter")
    hits = page.locator("ul.search > li > a")
    expect(hits.first).to_be_visible()
    hits.first.click()
    page.wait_for_url("**/manual/**.html*")
    expect(page.get_by_role("main")).to_contain_text("rotective")
    assert "search.html" not in page.url


def test_equations_have_the_font_of_the_manual_and_fit_the_page(open_console: Open, client: ServedClient) -> None:
    page = open_console(client, "manual/researcher/method.html", width=1280).page
    page.evaluate("async () => { await document.fonts.ready }")
    loaded = "() => [...document.fonts].filter((font) => font.status === 'loaded').map((font) => font.family)"
    assert "STIX Two Math" in str(page.evaluate(loaded))
    widths = page.evaluate(
        "() => [...document.querySelectorAll('div.math')].map((e) => [e.scrollWidth, e.clientWidth])"
    )
    assert len(widths) >= 8
    assert [(needed, available) for needed, available in widths if needed > available] == []


@pytest.mark.parametrize(("scheme", "width"), [("light", 1280), ("dark", 360)])
def test_the_manual_is_accessible(
    open_console: Open, client: ServedClient, scheme: Literal["light", "dark"], width: int
) -> None:
    for at in ("manual/", "manual/operator/faults.html", "manual/planner/errors.html"):
        page = open_console(client, at, scheme=scheme, width=width).page
        found = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
        serious = [
            (one["id"], one["help"], [node["html"] for node in one["nodes"]])
            for one in found
            if one["impact"] in SERIOUS
        ]
        assert not serious, at
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), at


def open_link(page: Page, name: str) -> Page:
    """Click a link and return the tab that opens. The console stays where it is."""
    before = page.url
    link = page.get_by_role("link", name=name).first
    assert link.get_attribute("rel") == "noopener"
    with page.context.expect_page() as opened:
        link.click()
    opened.value.wait_for_load_state()
    assert page.url.startswith(before)  # a screen may add the scan that it shows
    anchor = opened.value.evaluate("() => decodeURIComponent(location.hash).slice(1)")
    assert anchor
    expect(opened.value.locator(f'[id="{anchor}"]')).to_be_visible()
    return opened.value


def test_each_screen_opens_its_section_of_the_manual(open_console: Open, client: ServedClient) -> None:
    page = open_console(client).page
    sections = ("console.html#scan", "results.html#results", "console.html#history", "console.html#calibration")
    for key, section in enumerate(sections, start=1):
        page.keyboard.press(str(key))
        expect(page.locator(f'nav a[href="/manual/operator/{section}"]')).to_be_visible()
        opened = open_link(page, "Help for this page")
        assert opened.url.endswith(f"/manual/operator/{section}")
        opened.close()


def test_help_is_available_before_signing_in(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client).page
    assert open_link(page, "Help with signing in").url.endswith("/manual/operator/console.html#sign-in")


def test_the_reason_why_the_cell_is_not_ready_has_a_link(open_console: Open, client: ServedClient) -> None:
    page = open_console(client).page
    expect(page.get_by_role("banner").get_by_role("status")).to_contain_text("Not connected yet")
    opened = open_link(page, "What to do: not connected")
    assert opened.url.endswith("/manual/operator/faults.html#not-connected")


WHAT_TO_DO = "What to do: The robot's safety system made a protective stop"


def test_a_fault_and_the_scan_that_it_ended_have_a_link(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    location = cell.live.start()
    cell.live.wait_for_motion(location)
    cell.live.controller.protective_stop()
    expect(page.get_by_role("region", name="Fault")).to_be_visible()
    expect(page.get_by_role("region", name="The last scan")).to_be_visible()
    for region in ("Fault", "The last scan"):
        link = page.get_by_role("region", name=region).get_by_role("link", name=WHAT_TO_DO)
        expect(link).to_have_attribute("href", "/manual/operator/faults.html#protective-stop")
        expect(link).to_have_attribute("target", "_blank")
    page.keyboard.press("4")
    opened = open_link(page, WHAT_TO_DO)
    expect(opened.get_by_role("heading", name="Protective stop")).to_be_visible()
    cell.make_ready()


def test_a_refusal_has_a_link(open_console: Open, cell: Cell) -> None:
    opened = open_console(cell.live.client)
    opened.allow_errors("401")
    opened.page.get_by_label("Token").fill("no token of this cell")
    opened.page.get_by_role("button", name="Sign in").click()
    link = opened.page.get_by_role("alert").get_by_role("link", name="What to do: unauthorized")
    expect(link).to_have_attribute("href", "/manual/planner/errors.html#unauthorized")


def test_nothing_hides_stop_on_a_phone(open_console: Open, client: ServedClient) -> None:
    page = open_console(client, width=360).page
    page.get_by_role("button", name="Robot, camera and calibration").click()
    expect(page.get_by_role("banner").get_by_role("link", name="What to do")).to_be_visible()
    expect(page.get_by_role("link", name="Help for this page")).to_be_visible()
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    stop = page.get_by_role("button", name="STOP the arm")
    expect(stop).to_be_in_viewport(ratio=1)
    on_top = "(stop) => { const { x, y, width, height } = stop.getBoundingClientRect();"
    on_top += " return stop.contains(document.elementFromPoint(x + width / 2, y + height / 2)); }"
    assert stop.evaluate(on_top)
