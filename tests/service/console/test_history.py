"""The page of past scans."""

import json
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import expect

from recognition.request import RecognitionRequest
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from service.problems.document import problem_document
from tests.service.conftest import Serve, ServedClient
from tests.service.console.conftest import Open
from tests.service.security.conftest import without_recognition

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]

Finished = Callable[[httpx2.Client, str], dict[str, Any]]


@pytest.fixture(scope="module")
def data(serve: Serve, recording_file: Any, finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data folder of a service that has ended, with one scan that has a result and one that has none."""
    folder = tmp_path_factory.mktemp("past") / "data"
    with serve(folder) as client:
        recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
        request = {"mode": "replay", "recording": recording}
        done = client.post("/api/scans", json=request).headers["Location"]
        scan = finished(client, done)
        assert scan["state"] == "succeeded"
        assert client.get(scan["links"]["preview"]).status_code == 200  # wait until it is drawn
        failure = Failure("robot-lost", "the robot was lost on its way")
        failed = replace(new_scan("live", RecognitionRequest(), NOBODY), state="failed", failure=failure)
        client.app.state.context.store.scans.add(failed)
    return folder


@pytest.fixture
def past(serve: Serve, data: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """A service with a copy of the data folder. It ends after the page, which is made later."""
    copy = tmp_path_factory.mktemp("copy") / "data"
    shutil.copytree(data, copy)
    with without_recognition(serve, copy) as client:  # a test that recognises starts it
        yield client


def test_scans_are_listed_filtered_opened_and_protected(past: ServedClient, open_console: Open) -> None:
    page = open_console(past, "#/history").page
    rows = page.get_by_role("list", name="Scans, the newest first").locator("> li")
    expect(rows).to_have_count(2)
    expect(rows.nth(0)).to_contain_text("Failed")
    expect(rows.nth(1)).to_contain_text("1 string, 0 crossings")
    expect(rows.nth(1).locator("img")).to_be_visible()

    rows.nth(0).get_by_role("button").click()
    expect(rows.nth(0)).to_contain_text("The connection to the robot was lost. The robot was lost on its way.")
    page.get_by_label("Outcome").select_option(label="with a result")
    expect(rows).to_have_count(1)
    rows.get_by_role("button", expanded=False).click()

    with page.expect_download() as download:
        page.get_by_role("link", name="Model (JSON)").click()
    (scan,) = past.get("/api/scans?state=succeeded").json()["scans"]
    assert download.value.suggested_filename == f"{scan['id']}.json"
    assert json.loads(download.value.path().read_bytes()) == past.get(scan["links"]["model"]).json()
    with page.expect_download() as download:
        page.get_by_role("link", name="Recording (MCAP)").click()
    assert download.value.path().read_bytes() == past.get(scan["links"]["recording"]).content

    page.get_by_role("button", name="Protect from removal").click()
    expect(page.get_by_role("button", name="Remove the protection")).to_be_visible()
    assert past.get(scan["links"]["self"]).json()["kept"]
    page.get_by_label("only protected scans").check()
    expect(rows).to_have_count(1)
    # With the filter, the scan would leave the list as soon as its protection is removed.
    page.get_by_label("only protected scans").uncheck()
    expect(rows).to_have_count(1)
    page.get_by_role("button", name="Remove the protection").click()
    expect(page.get_by_role("button", name="Protect from removal")).to_be_visible()
    page.get_by_label("only protected scans").check()
    expect(rows).to_have_count(0)
    page.get_by_label("only protected scans").uncheck()
    expect(rows).to_have_count(1)
    page.get_by_label("To", exact=True).fill("2020-01-01")
    expect(page.get_by_text("No scan matches the filters")).to_be_visible()
    expect(rows).to_have_count(0)


def test_a_list_is_requested_again_after_an_error(past: ServedClient, open_console: Open) -> None:
    opened = open_console(past, "#/scan")
    opened.allow_errors("503")
    page = opened.page
    # The page requests its lists again after it has received the last scan.
    expect(page.get_by_role("region", name="The last scan")).to_contain_text(re.compile("Accept|Failed"))
    refusal = problem_document("busy", "another program has locked the database; try again")
    page.route("**/api/scans?limit=20", lambda route: route.fulfill(status=503, json=refusal), times=1)
    page.keyboard.press("3")
    expect(page.get_by_role("main")).to_contain_text("Another program has locked the database; try again.")
    expect(page.get_by_role("list", name="Scans, the newest first").locator("> li").first).to_be_visible()
    expect(page.get_by_text("Another program has locked the database; try again.")).to_have_count(0)


def test_a_scan_is_recognised_again_with_other_parameters(past: ServedClient, open_console: Open) -> None:
    page = open_console(past, "#/history").page
    page.get_by_label("Outcome").select_option(label="with a result")
    page.get_by_role("list", name="Scans, the newest first").get_by_role("button").last.click()
    again = page.get_by_role("group", name="Recognise again")
    again.get_by_label("Method", exact=True).select_option("matching")
    again.get_by_label("String radius, in mm", exact=True).fill("4")
    again.get_by_role("button", name="Recognise again").click()
    again.get_by_role("link", name="Look at the new result").click()
    expect(page.get_by_role("heading", name="1 string, 0 crossings")).to_be_visible()
    made = past.get("/api/scans?limit=1").json()["scans"][0]
    assert (made["method"], made["string_radius_m"], made["source"] is not None) == ("matching", 0.004, True)
    expect(page.get_by_role("main")).to_contain_text("matching")
    assert page.url.endswith(made["id"])


def test_older_scans_are_shown_on_request_and_stay_after_a_new_scan(
    past: ServedClient, open_console: Open, finished: Finished
) -> None:
    store = past.app.state.context.store
    for _ in range(25):
        store.scans.add(replace(new_scan("live", RecognitionRequest(), NOBODY), state="aborted"))
    before = len(past.get("/api/scans").json()["scans"])
    page = open_console(past, "#/history").page
    rows = page.get_by_role("list", name="Scans, the newest first").locator("> li")
    expect(rows).to_have_count(20)
    page.get_by_role("button", name="Show older scans").click()
    expect(rows).to_have_count(min(before, 40))
    recording = past.get("/api/recordings").json()["recordings"][0]["id"]
    finished(past, past.post("/api/scans", json={"mode": "replay", "recording": recording}).headers["Location"])
    expect(rows.first.locator(".badge")).to_have_text(re.compile("Accept|Look first"))
    expect(rows).to_have_count(min(before + 1, 40))


def test_a_scan_in_the_address_is_shown_even_if_too_old_for_the_list(past: ServedClient, open_console: Open) -> None:
    store = past.app.state.context.store
    (old,) = store.scans.newest(1)
    for _ in range(21):
        later = replace(new_scan("live", RecognitionRequest(), NOBODY), state="scanning")
        store.scans.add(later)
        store.scans.end(later.id, "aborted", Failure("stopped", "the arm was stopped"))
    page = open_console(past, f"#/history/{old.id}").page
    rows = page.get_by_role("list", name="Scans").get_by_role("button", expanded=True)
    expect(rows).to_have_count(1)
    expect(page.get_by_role("group").get_by_text(old.id)).to_be_visible()


OUTCOMES = [
    ("succeeded", "accept", 1, 1, "warn", "Look first"),
    ("succeeded", "accept", 1, 0, "good", "Accept"),
    ("partial", "accept", 1, 0, "warn", "Accept, views are missing"),
    ("succeeded", "review", 0, 22, "warn", "No string found"),
    ("succeeded", "refuse", 1, 22, "bad", "Do not use"),
    ("partial", "refuse", 1, 22, "bad", "Do not use"),
    ("partial", "review", 1, 22, "warn", "Look first, views are missing"),
    ("succeeded", "review", 1, 22, "warn", "Look first"),
]
"""State, verdict, number of strings and of doubts of a scan, and the style and the text of its badge."""


def test_a_doubtful_result_is_never_shown_as_good(open_console: Open, serve: Serve, tmp_path: Path) -> None:
    findings = [{"code": "sharp-bend", "severity": "blocking", "message": "one thing blocks"}]
    findings += [{"code": "possible-bar", "severity": "doubt", "message": f"doubt {number}"} for number in range(4)]
    counts = {"crossings": 0, "note_count": 3}
    with without_recognition(serve, tmp_path) as client:
        for state, verdict, strings, doubts, _, _ in OUTCOMES:
            listed = {"doubts": findings[:doubts], "doubt_count": doubts}
            summary = counts | {"chains": strings, "verdict": verdict} | listed
            scan = replace(new_scan("live", RecognitionRequest(), NOBODY), state=state, summary=summary)
            client.app.state.context.store.scans.add(scan)
        opened = open_console(client, "#/history")
        opened.allow_errors("404|500")  # the scans have no thumbnails
        page = opened.page
        rows = page.get_by_role("list", name="Scans, the newest first").locator("> li")
        expect(rows).to_have_count(len(OUTCOMES))
        for row, (_, _, _, _, tone, word) in zip(rows.all(), reversed(OUTCOMES), strict=True):
            expect(row.locator(".badge")).to_have_class(f"badge {tone}")
            expect(row.locator(".badge")).to_have_text(re.compile(rf"^\S {word}$"))

        page.keyboard.press("1")
        last = page.get_by_role("region", name="The last scan")
        expect(last.locator(".badge")).to_have_text("▲ Look first")
        expect(last.locator(".badge")).to_have_class("badge warn")
        expect(last.locator(".note:visible")).to_have_text(
            ["⬣ One thing blocks.", "▲ Doubt 0.", "▲ Doubt 1.", re.compile("^17 further doubts are not listed here")]
        )
        last.locator("summary", has_text="2 more doubts").click()
        expect(last.get_by_text("Doubt 3.")).to_be_visible()
        page.close()  # before its service ends
