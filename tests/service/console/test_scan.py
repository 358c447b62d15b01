"""The page of a scan: live scans, scans of a recording and checked input."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.console.conftest import Cell, Open, wait_until_drawn
from tests.service.live_cell import live_cell

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes


PRESSES = 10
PRESS_WHERE_IT_APPEARS = """(count) => {
    window.presses = 0;
    const press = () => {
        const scan = [...document.querySelectorAll("button")].find((one) => one.innerText.startsWith("Scan:"));
        if (scan === undefined || scan.offsetParent === null) return;
        scan.click();
        if (++window.presses === count) clearInterval(timer);
    };
    const timer = setInterval(press, 100);
}"""
"""Press the button of the next scan during the first second after this one, as a finger may that meant the picture."""


def test_a_first_visitor_completes_a_live_scan(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()  # before anything moves
    page.get_by_role("button", name="What is: String radius").click()
    expect(page.get_by_text("Half of the string's thickness")).to_be_visible()
    page.get_by_label("String radius, in mm", exact=True).fill("4.2")
    page.get_by_role("button", name="Scan: the arm will move").click()
    progress = page.get_by_role("region", name="Scan in progress")
    expect(progress).to_contain_text(re.compile(r"\d of 8 views recorded"))
    expect(page.get_by_role("banner").get_by_role("status")).to_contain_text("Working")
    page.evaluate(PRESS_WHERE_IT_APPEARS, PRESSES)
    images = page.get_by_role("region", name="Views of the scan").get_by_role("img")
    expect(images.first).to_be_visible()  # while the arm moves to the next viewpoint
    last = page.get_by_role("region", name="The last scan")
    expect(last.locator(".badge").first).to_have_text(re.compile("Accept|Look first"))
    expect(last).to_contain_text("1 string, 1 crossing")
    expect(images).to_have_count(8)
    assert all(width > 100 for width in images.evaluate_all("all => all.map((one) => one.naturalWidth)"))
    wait_until(lambda: page.evaluate("window.presses") == PRESSES)
    expect(last).to_be_visible()  # no press started another scan
    last.get_by_role("link", name="Look at the result").click()
    expect(page.get_by_role("heading", name="1 string, 1 crossing")).to_be_visible()
    wait_until_drawn(page)


@pytest.mark.without_3d
def test_a_quick_scan_of_a_clear_table_takes_half_the_views(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    viewpoints = page.get_by_role("textbox", name="Viewpoints")
    expect(viewpoints).to_be_visible()
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
    with page.expect_request("**/api/viewpoints/plan") as check:
        page.get_by_label("Quick: four viewpoints, and more only if something is doubtful").check()
    assert check.value.post_data_json == {"views": "auto"}
    expect(viewpoints).to_have_count(0)
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
    page.get_by_label("String radius, in mm", exact=True).fill("4.2")
    with page.expect_request("**/api/scans") as request:
        page.get_by_role("button", name="Scan: the arm will move").click()
    assert (request.value.post_data_json or {})["views"] == "auto"
    last = page.get_by_role("region", name="The last scan")
    expect(last).to_contain_text("1 string, 1 crossing")
    expect(page.get_by_role("region", name="Views of the scan").get_by_role("img")).to_have_count(4)
    expect(page.get_by_label("Quick: four viewpoints")).to_be_checked()  # kept for the next scan
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
    cell.live.release()  # a connected arm would take a fifth of a core during the next tests


@pytest.mark.without_3d
def test_another_number_of_viewpoints_is_checked_at_once(open_console: Open, client: ServedClient) -> None:
    page = open_console(client).page
    expect(page.get_by_text("Reachable: 8 of 8")).to_be_visible()
    for number in ("6", "7"):
        page.get_by_role("textbox", name="Viewpoints").fill(number)
        expect(page.get_by_text(f"Reachable: {number} of {number}")).to_be_visible()


@pytest.mark.without_3d
def test_quick_is_ticked_as_configured_and_unticked_is_not_quick(
    open_console: Open, serve: Serve, tmp_path: Path
) -> None:
    with live_cell(serve, tmp_path, scan={"views": "auto"}) as live:
        page = open_console(live.client).page
        quick = page.get_by_label("Quick: four viewpoints")
        expect(quick).to_be_checked()
        expect(page.get_by_role("textbox", name="Viewpoints")).to_have_count(0)
        quick.uncheck()
        expect(page.get_by_role("textbox", name="Viewpoints")).to_have_attribute("placeholder", "8")
        with page.expect_request("**/api/scans") as request:
            page.get_by_role("button", name="Scan: the arm will move").click()
        assert (request.value.post_data_json or {})["views"] == 8
        page.get_by_role("button", name="Cancel this scan").click()
        expect(page.get_by_role("region", name="The last scan")).to_contain_text("Stopped")
        expect(quick).not_to_be_checked()
        page.close()  # before the service ends


@pytest.mark.without_3d
def test_a_scan_that_is_not_quick_has_the_configured_number(open_console: Open, serve: Serve, tmp_path: Path) -> None:
    with live_cell(serve, tmp_path, scan={"views": 6}) as live:
        page = open_console(live.client).page
        viewpoints = page.get_by_role("textbox", name="Viewpoints")
        expect(viewpoints).to_have_attribute("placeholder", "6, configured")
        expect(page.get_by_label("Quick: four viewpoints")).not_to_be_checked()
        with page.expect_request("**/api/scans") as request:
            page.get_by_role("button", name="Scan: the arm will move").click()
        assert (request.value.post_data_json or {})["views"] == 6
        page.get_by_role("button", name="Cancel this scan").click()
        expect(page.get_by_role("region", name="The last scan")).to_contain_text("Stopped")
        page.close()  # before the service ends


@pytest.mark.without_3d
def test_an_invalid_number_is_reported_at_its_field(open_console: Open, client: ServedClient) -> None:
    page = open_console(client).page
    scan = page.get_by_role("button", name="Scan: the arm will move")
    radius = page.get_by_label("String radius, in mm", exact=True)
    low_m, high_m = client.get("/api/cell/geometry").json()["scan"]["string_radius_range_m"]
    refused = page.get_by_text(f"Enter a number from {low_m * 1000:g} to {high_m * 1000:g} mm")
    expect(scan).to_be_enabled()
    for text in ("420", "1,2,3", "0", "four", "-4"):
        radius.fill(text)
        expect(refused).to_be_visible()
        expect(scan).to_be_disabled()
    radius.fill("")
    expect(refused).to_have_count(0)
    expect(scan).to_be_enabled()
    page.get_by_role("textbox", name="Viewpoints").fill("2.5")
    expect(page.get_by_text("Enter a whole number from 1 to 32")).to_be_visible()
    expect(scan).to_be_disabled()


@pytest.mark.without_3d
def test_a_radius_may_have_a_decimal_comma(open_console: Open, client: ServedClient, recording_file: Path) -> None:
    client.post("/api/recordings", content=recording_file.read_bytes())
    page = open_console(client).page
    page.get_by_label("A recording of an earlier scan").check()
    page.get_by_label("Recording", exact=True).select_option(index=1)
    page.get_by_label("String radius, in mm", exact=True).fill("4,2")
    page.keyboard.press("Tab")
    page.keyboard.press("2")  # the input is kept
    page.keyboard.press("1")
    expect(page.get_by_label("String radius, in mm", exact=True)).to_have_value("4,2")
    with page.expect_request("**/api/scans") as request:
        page.get_by_role("button", name="Recognise the recording").click()
    sent = request.value.post_data_json or {}
    assert sent["string_radius_m"] == pytest.approx(0.0042)
    expect(page.get_by_role("region", name="The last scan")).to_contain_text("1 string, 0 crossings")


@pytest.mark.without_3d
def test_a_scan_is_cancelled(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    page.get_by_role("button", name="Scan: the arm will move").click()
    page.get_by_role("button", name="Cancel this scan").click()
    expect(page.get_by_role("region", name="The last scan")).to_contain_text("Stopped")
    assert not cell.live.moving()
    cell.make_ready()


def test_the_views_of_a_stopped_scan_are_recognised_at_once(open_console: Open, cell: Cell) -> None:
    page = open_console(cell.live.client, token=cell.tokens["operator"]).page
    page.get_by_label("String radius, in mm", exact=True).fill("4.2")
    page.get_by_role("button", name="Scan: the arm will move").click()
    expect(page.get_by_role("region", name="Scan in progress")).to_contain_text("4 of 8 views recorded")
    page.get_by_role("button", name="STOP the arm").click()
    stopped = page.get_by_role("region", name="After a stop")
    expect(stopped).to_contain_text(re.compile(r"Stopped at \d\d:\d\d:\d\d by an-operator\."))
    last = page.get_by_role("region", name="The last scan")
    expect(last).to_contain_text("The arm was stopped by request of an-operator.")
    last.get_by_role("button", name="Recognise again").click()
    expect(page.get_by_role("region", name="Verdict")).to_contain_text("Recognised again")
    note = page.locator("p", has_text="was broken off")
    expect(note).to_contain_text(re.compile(r"was broken off: Aborted by request\. [4-7] of 8 views recorded\."))
    wait_until_drawn(page)
    shown = page.url
    page.keyboard.press("1")
    expect(last.get_by_role("link", name="Look at the result")).to_be_visible()  # of the recognition
    expect(last.get_by_role("button", name="Recognise again")).to_have_count(0)
    page.keyboard.press("2")
    expect(page.get_by_role("region", name="Verdict")).to_be_visible()
    assert page.url == shown, "the table of the stopped scan is newer than that of the last complete scan"
    cell.make_ready()


def test_a_recording_is_added_and_recognised(open_console: Open, client: ServedClient, recording_file: Path) -> None:
    page = open_console(client).page
    page.get_by_label("A recording of an earlier scan").check()
    recognise = page.get_by_role("button", name="Recognise the recording")
    expect(recognise).to_be_disabled()
    page.get_by_label("Add a file").set_input_files(recording_file)
    expect(recognise).to_be_enabled()
    expect(page.get_by_label("Recording", exact=True).locator("option:checked")).to_contain_text("4 views")
    expect(page.get_by_label("Recording", exact=True).locator("option:checked")).to_contain_text(recording_file.name)
    recognise.click()
    last = page.get_by_role("region", name="The last scan")
    expect(last).to_contain_text("1 string, 0 crossings")
    last.get_by_role("link", name="Look at the result").click()
    wait_until_drawn(page)


@pytest.mark.without_3d
def test_an_invalid_recording_is_refused_with_a_message(
    open_console: Open, client: ServedClient, tmp_path: Path
) -> None:
    opened = open_console(client)
    opened.allow_errors("422")
    page = opened.page
    wrong = tmp_path / "wrong.mcap"
    wrong.write_bytes(b"no recording at all")
    page.get_by_label("A recording of an earlier scan").check()
    page.get_by_label("Add a file").set_input_files(wrong)
    expect(page.get_by_role("alert").filter(has_text="Not an MCAP file")).to_contain_text("wrong.mcap")
