"""Signing in on a phone: by typing a code, and by the address of a QR code."""

import json

import pytest
from playwright.sync_api import expect

from service.cli.main import main
from service.clock import utc_now
from service.security.auth.sessions import SESSIONS_FILE, add_code, read_sessions
from service.security.auth.tokens import TOKENS_FILE, add_token, read_tokens, remove_token
from tests.service.console.conftest import Cell, Open, Opened
from tests.service.console.test_accessibility import assert_usable

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]

PHONE = {"width": 390, "height": 844}
SIGNED_IN = "carl, operator: can scan"


@pytest.fixture(autouse=True)
def carl(cell: Cell) -> None:
    """Add the operator carl, without sessions of earlier tests."""
    if any(token.name == "carl" for token in read_tokens(cell.data / TOKENS_FILE)):
        remove_token(cell.data, "carl")
    add_token(cell.data, "carl", "operator")


def code_of_carl(cell: Cell) -> str:
    return add_code(cell.data, "carl", 10, utc_now()).code


def sign_ins(opened: Opened) -> list[str]:
    """Return the bodies of the requests that sign in."""
    return [one.post_data or "" for one in opened.requests if one.method == "POST" and "/api/session" in one.url]


def test_a_code_may_be_typed_on_a_phone_in_lower_case_with_a_space(open_console: Open, cell: Cell) -> None:
    opened = open_console(cell.live.client, **PHONE)
    opened.allow_errors("401")
    page, code = opened.page, code_of_carl(cell)
    field = page.get_by_label("Code or token")
    assert [field.get_attribute(name) for name in ("type", "autocapitalize", "autocomplete", "spellcheck")] == [
        "text",
        "off",
        "one-time-code",
        "false",
    ]
    field.press_sequentially("aaaa aaaa")
    page.get_by_role("button", name="Sign in").click()
    expect(page.locator("main").get_by_role("alert")).to_contain_text("wrong, was used, or has expired")
    assert_usable(page)
    field.fill("")
    field.press_sequentially(code.lower().replace("-", " "))
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_text(SIGNED_IN)).to_be_visible()
    assert [list(json.loads(body)) for body in sign_ins(opened)] == [["code"], ["code"]]
    page.reload()
    expect(page.get_by_text(SIGNED_IN)).to_be_visible()
    remove_token(cell.data, "carl")
    expect(page.get_by_role("heading", name="Sign in")).to_be_visible()


def test_the_address_of_a_qr_code_signs_in_with_one_press_and_not_without(
    open_console: Open, cell: Cell, capsys: pytest.CaptureFixture[str]
) -> None:
    origin = str(cell.live.client.base_url).rstrip("/")
    assert main(["token", "code", "carl", "--data-dir", str(cell.data), "--address", origin, "--json"]) == 0
    address = json.loads(capsys.readouterr().out)["address"]
    opened = open_console(cell.live.client, address.removeprefix(f"{origin}/"), **PHONE)
    page = opened.page
    expect(page.get_by_text("Press the button to sign in with it")).to_be_visible()
    expect(page.get_by_label("Code or token")).to_have_value(address[-9:])
    page.reload()
    expect(page.get_by_label("Code or token")).to_have_value(address[-9:])
    assert sign_ins(opened) == []
    assert len(read_sessions(cell.data / SESSIONS_FILE).codes) == 1
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_text(SIGNED_IN)).to_be_visible()
    assert page.url == f"{origin}/#/scan"
    assert len(sign_ins(opened)) == 1
    page.go_back()  # the address with the code is not in the history
    assert "sign-in" not in page.url
    codes_in_addresses = [one.url for one in opened.requests if address[-9:] in one.url.partition("#")[0]]
    assert not codes_in_addresses


def test_a_refused_code_leaves_the_address_and_can_be_replaced(open_console: Open, cell: Cell) -> None:
    opened = open_console(cell.live.client, "#/sign-in/AAAA-AAAA", **PHONE)
    opened.allow_errors("401")
    page = opened.page
    page.get_by_role("button", name="Sign in").click()
    expect(page.locator("main").get_by_role("alert")).to_contain_text("wrong, was used, or has expired")
    assert page.url.endswith("/#/sign-in")
    page.evaluate("(code) => { location.hash = `#/sign-in/${code}`; }", code_of_carl(cell))  # the next scan
    expect(page.get_by_text("Press the button to sign in with it")).to_be_visible()
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_text(SIGNED_IN)).to_be_visible()


def test_a_code_can_replace_another_caller_or_be_left_unused(open_console: Open, cell: Cell) -> None:
    code = code_of_carl(cell)
    address = f"#/sign-in/{code}"
    page = open_console(cell.live.client, address, token=cell.tokens["viewer"], scheme="dark", **PHONE).page
    expect(page.get_by_text("You are signed in as an-viewer")).to_be_visible()
    assert_usable(page)
    page.get_by_role("button", name="Stay signed in as an-viewer").click()
    expect(page.get_by_text("an-viewer, viewer")).to_be_visible()
    assert page.url.endswith("/#/scan")
    page.evaluate("(code) => { location.hash = `#/sign-in/${code}`; }", code)
    page.get_by_role("button", name="Sign in", exact=True).click()
    expect(page.get_by_text(SIGNED_IN)).to_be_visible()


def test_a_token_is_not_readable_in_the_field(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client).page
    field = page.get_by_label("Code or token")
    shown = "(input) => getComputedStyle(input).webkitTextSecurity"
    field.fill("7K3M-Q9TX")
    assert field.evaluate(shown) == "none"
    field.fill(cell.tokens["viewer"])
    expect(field).to_have_class("secret")
    assert field.evaluate(shown) == "disc"
