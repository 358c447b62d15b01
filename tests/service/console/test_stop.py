"""A person stops the arm on the page."""

from collections.abc import Callable
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Route, expect

from tests.service.console.conftest import Cell, Open

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]

Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.mark.parametrize("control", ["button", "keys"])
def test_stop_during_a_move(open_console: Open, cell: Cell, finished: Finished, control: str) -> None:
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    page.get_by_role("button", name="Scan: the arm will move").click()
    expect(page.get_by_text("views recorded", exact=False)).to_be_visible()
    location = cell.live.client.get("/api/scans?limit=1").json()["scans"][0]["links"]["self"]
    cell.live.wait_for_motion(location)
    page.keyboard.press("3")  # the stop works on every screen
    if control == "button":
        page.get_by_role("button", name="STOP the arm").click()
    else:
        page.keyboard.press("Control+.")
    expect(page.locator("#stop-message")).to_contain_text("The arm was stopped")
    assert not cell.live.moving()
    assert finished(cell.live.client, location)["state"] == "aborted"
    page.keyboard.press("1")
    expect(page.get_by_role("region", name="The last scan").get_by_text("Stopped", exact=False).first).to_be_visible()
    cell.make_ready()


def test_stop_says_that_it_does_not_reach_a_released_arm(open_console: Open, cell: Cell) -> None:
    cell.make_ready()
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()  # the page may move until then
    page.get_by_role("button", name="Release the arm").click()
    expect(page.get_by_role("button", name="Connect arm and camera")).to_be_visible()
    page.get_by_role("button", name="STOP the arm").click()
    expect(page.locator("#stop-message")).to_contain_text("released to another program, which this button")
    cell.make_ready()


def test_the_first_answers_do_not_clear_the_outcome_of_an_earlier_stop(
    open_console: Open, cell: Cell, finished: Finished
) -> None:
    """STOP is pressed while the page loads. Its first answer about scans still reports the stopped scan as running."""
    opened = open_console(cell.live.client, token=cell.tokens["viewer"])
    page = opened.page
    location = cell.live.start()
    cell.live.wait_for_motion(location)
    running = cell.live.client.get("/api/scans?limit=10").text
    held: list[Route] = []

    def hold(route: Route) -> None:
        held.append(route)

    page.route("**/api/session", hold)
    page.route("**/api/scans?*", lambda route: route.fulfill(body=running, content_type="application/json"), times=1)
    page.route("**/api/events*", lambda route: None)  # as slow as the rest
    page.reload()
    page.get_by_role("button", name="STOP the arm").click()
    expect(page.locator("#stop-message")).to_contain_text("The arm was stopped")
    page.unroute("**/api/session")
    for route in held:
        route.continue_()
    expect(page.get_by_role("region", name="After a stop")).to_be_visible()
    expect(page.locator("#stop-message")).to_contain_text("The arm was stopped")
    page.unroute_all(behavior="ignoreErrors")
    assert finished(cell.live.client, location)["state"] == "aborted"
    cell.make_ready()


def test_stop_does_not_wait_for_pending_requests(open_console: Open, cell: Cell) -> None:
    """The page's requests get no answer, and a browser opens at most six connections to a service."""
    cell.make_ready()
    opened = open_console(cell.live.client, token=cell.tokens["operator"])
    page = opened.page
    expect(page.get_by_role("button", name="Scan: the arm will move")).to_be_enabled()
    held: list[object] = []
    page.route(
        "**/api/**", lambda route: route.continue_() if route.request.url.endswith("/stop") else held.append(route)
    )
    for screen in ("3", "4", "1"):
        page.keyboard.press(screen)
        page.wait_for_timeout(100)  # for the requests of the screen
    while len(held) < 3:
        page.wait_for_timeout(50)
    page.get_by_role("button", name="STOP the arm").click()
    expect(page.locator("#stop-message")).to_contain_text("The arm was stopped")
    page.unroute_all(behavior="ignoreErrors")


def test_a_stop_that_does_not_get_through_is_reported(open_console: Open, cell: Cell) -> None:
    cell.make_ready()
    opened = open_console(cell.live.client, token=cell.tokens["operator"])
    opened.allow_errors("ERR_FAILED")
    page = opened.page
    expect(page.get_by_role("banner").get_by_role("status")).to_be_visible()
    attempts: list[str] = []

    def refuse(route: Route) -> None:
        attempts.append(route.request.url)
        route.abort()

    page.route("**/api/cell/stop", refuse)
    page.get_by_role("button", name="STOP the arm").click()
    expect(page.locator("#stop-message")).to_contain_text("STOP HAS NOT GOT THROUGH YET")
    while len(attempts) < 3:
        page.wait_for_timeout(100)
    page.unroute_all()
    expect(page.locator("#stop-message")).to_contain_text("The arm was stopped")  # the repeated request
