"""Signing in, and the controls that each role sees."""

from collections.abc import Callable
from typing import Any

import httpx2
import pytest
from playwright.sync_api import expect

from service.security.auth.tokens import add_token, remove_token
from tests.service.console.conftest import Cell, Open

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

SCAN = "Scan: the arm will move"


def test_a_token_is_entered_once_and_hidden_from_scripts(open_console: Open, cell: Cell) -> None:
    opened = open_console(cell.live.client)
    page = opened.page
    opened.allow_errors("401")  # the wrong token, and the stop of a caller who is not signed in
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    page.get_by_role("button", name="STOP the arm").click()
    expect(page.locator("#stop-message")).to_contain_text("NOT STOPPED: nobody is signed in here")
    page.get_by_label("Token").fill("pct_" + "a" * 43)
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_text("The code or token is wrong", exact=False)).to_be_visible()
    page.get_by_label("Token").fill(add_token(cell.data, "anna", "operator"))
    page.keyboard.press("Enter")
    expect(page.get_by_text("anna, operator: can scan")).to_be_visible()
    expect(page.locator("#stop-message")).to_be_empty()  # a person is signed in now
    assert page.evaluate("() => document.cookie") == ""
    page.reload()
    expect(page.get_by_text("anna, operator: can scan")).to_be_visible()
    remove_token(cell.data, "anna")
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


def test_signing_out_ends_the_session(open_console: Open, cell: Cell) -> None:
    opened = open_console(cell.live.client, token=cell.tokens["viewer"])
    opened.allow_errors("401")  # requests that were pending
    page = opened.page
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()
    page.reload()
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


def test_each_role_sees_only_its_permitted_actions(open_console: Open, cell: Cell) -> None:
    viewer = open_console(cell.live.client, token=cell.tokens["viewer"]).page
    operator = open_console(cell.live.client, token=cell.tokens["operator"]).page
    expect(viewer.get_by_text("Only operators start scans")).to_be_visible()
    expect(viewer.get_by_role("button", name=SCAN)).to_have_count(0)
    expect(viewer.get_by_role("button", name="STOP the arm")).to_be_enabled()
    expect(operator.get_by_role("button", name=SCAN)).to_be_enabled()
    for page in (viewer, operator):
        page.keyboard.press("4")
        expect(page.get_by_role("heading", name="Calibration", level=1)).to_be_visible()
        expect(page.get_by_role("button", name="the arm moves", exact=False)).to_have_count(0)


def test_a_viewer_may_stop(open_console: Open, cell: Cell, finished: Finished) -> None:
    location = cell.live.start()
    cell.live.wait_for_motion(location)
    page = open_console(cell.live.client, token=cell.tokens["viewer"]).page
    page.get_by_role("button", name="STOP the arm").click()
    expect(page.locator("#stop-message")).to_contain_text("The arm was stopped")
    assert not cell.live.moving()
    assert finished(cell.live.client, location)["state"] == "aborted"
    cell.make_ready()
