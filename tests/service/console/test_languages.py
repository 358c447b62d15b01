"""The catalogues of the other languages are complete, and the console shows them."""

import json
import re
import subprocess
from pathlib import Path
from typing import Any, get_args

import pytest
from playwright.sync_api import Page, Route, expect

from cell.planning.grasp_reach import ReachReason
from recognition.model.finding_types import FINDING_TYPES, FindingCode
from service.problems.problem_types import PROBLEM_TYPES
from tests.service.conftest import ServedClient
from tests.service.console.boxes import assert_texts_fit
from tests.service.console.conftest import Cell, Open, wait_until_drawn
from tests.service.console.test_texts import NODE, PLACEHOLDER_OR_TAG, WEB, texts_of

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes

TEXTS = WEB / "src/texts"
LANGUAGES = sorted(path.stem for path in TEXTS.glob("*.json") if path.stem != "en")
SHOWN_PROBLEMS = {
    slug for slug, kind in PROBLEM_TYPES.items() if kind.status is not None or kind.group == "Start a scan"
}
"""Problems that a person can see in the console. The command line reports the others."""
SIZES = {"phone": (390, 844), "tablet": (1024, 768), "desktop": (1920, 1080)}
FILL = """
import { chooseLanguage } from "./src/texts/translate";
import { findingText } from "./src/texts/findings";
globalThis.document = { documentElement: {}, querySelectorAll: () => [] };
const [findings, tags] = JSON.parse(process.argv[2]);
const filled = {};
for (const tag of tags) {
    await chooseLanguage([tag]);
    filled[tag] = findings.map(findingText);
}
console.log(JSON.stringify(filled));
"""
"""Prints the texts of findings in some languages."""


def catalogue(tag: str) -> dict[str, Any]:
    """Return the catalogue of a language."""
    return json.loads((TEXTS / f"{tag}.json").read_text())


def singular(key: str) -> str:
    """Return the key of a plural text as `.other`, which every language has."""
    head, _, form = key.rpartition(".")
    return f"{head}.other" if form in ("zero", "one", "two", "few", "many") else key


@pytest.mark.parametrize("tag", LANGUAGES)
def test_a_language_has_every_text(tag: str) -> None:
    english, translated = texts_of(catalogue("en")), texts_of(catalogue(tag))
    missing = {singular(key) for key in english} - {singular(key) for key in translated}
    codes = {f".finding.{code}" for code in FINDING_TYPES} | {f".problem.{slug}.title" for slug in SHOWN_PROBLEMS}
    codes |= {f".result.grasp.reason.{code}" for code in get_args(ReachReason)}
    missing |= codes - set(translated)
    assert not missing, f"add these texts to service/console/web/src/texts/{tag}.json: {sorted(missing)}"
    assert not [key for key, text in translated.items() if not text.strip(" .:")]


@pytest.mark.parametrize("tag", LANGUAGES)
def test_a_language_has_no_text_of_an_unknown_code(tag: str) -> None:
    translated = catalogue(tag)
    assert set(translated["finding"]) <= set(FINDING_TYPES)
    assert set(translated["result"]["grasp"]["reason"]) <= set(get_args(ReachReason))
    for slug, texts in translated["problem"].items():
        assert set(texts) <= {"title", "detail", "advice"}, slug
        names = set(re.findall(r"\{(\w+)\}", texts.get("detail", "")))
        assert names <= set(PROBLEM_TYPES[slug].parameters), slug
        assert not PLACEHOLDER_OR_TAG.search(texts["title"] + texts.get("advice", "")), slug


def occurrence(code: FindingCode) -> dict[str, Any]:
    """Return a finding as the service writes it. A type without a value has none."""
    kind = FINDING_TYPES[code]
    finding: dict[str, Any] = {"code": code, "severity": kind.severity, "message": "a message in English"}
    finding |= {"chains": [3, 4], "crossing": 5, "view": 6, "end": "last"}
    finding |= {"s_range_m": [0.02, 0.05], "point_m": [0.3, -0.1, 0.0015]}
    return finding if kind.value is None else finding | {"value": 0.25, "limit": 0.125}


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The texts of one finding of each code, by language. Two more findings lack what their texts need."""
    folder = tmp_path_factory.mktemp("texts")
    bundle = folder / "fill.mjs"
    options = ("--bundle", "--format=esm", "--platform=node", f"--outfile={bundle}")
    subprocess.run(
        [NODE, "node_modules/esbuild/bin/esbuild", *options],
        cwd=WEB,
        check=True,
        capture_output=True,
        text=True,
        input=FILL,
    )
    lacking = [{"code": code, "severity": "doubt", "message": "a message"} for code in ("above-table", "unknown-code")]
    given = json.dumps([[*map(occurrence, FINDING_TYPES), *lacking], ["en", *LANGUAGES]])
    return json.loads(subprocess.run([NODE, bundle, given], check=True, capture_output=True, text=True).stdout)


@pytest.mark.parametrize("tag", LANGUAGES)
def test_the_text_of_each_finding_is_filled_with_its_values(filled: dict[str, list[str]], tag: str) -> None:
    for code, text in zip(FINDING_TYPES, filled[tag], strict=False):
        assert "{" not in text, code
        template = catalogue(tag)["finding"][code]
        names = set(re.findall(r"\{(\w+)\}", template))
        assert text != "A message in English.", (code, "the console fills none of its placeholders", names)
        assert ("A message in English." in text) == ("message" in names), code
        for name, shown in {"crossing": "5", "view": "6"}.items():
            assert name not in names or shown in text, code
    assert filled[tag][-2:] == ["A message."] * 2


def test_the_values_of_a_finding_have_the_unit_of_its_code(filled: dict[str, list[str]]) -> None:
    assert set(filled["en"]) == {"A message in English.", "A message."}  # English is the language of the service
    german = dict(zip(FINDING_TYPES, filled["de"], strict=False))
    assert "14°" in german["sharp-bend"]
    assert "Kreuzung 5 bei (300,0; -100,0; 1,5) mm" in german["crossing-undecided"]
    assert "Konfidenz 25 %" in german["crossing-undecided"]
    assert "Schnur 3 und 4, 20 bis 50 mm" in german["connection-uncertain"]
    assert "Das letzte Ende von Schnur 3 und 4" in german["end-unobserved"]
    assert "Radius ist 250,0 mm, erwartet sind 125,0 mm" in german["radius-smaller"]


def with_a_doubt(route: Route) -> None:
    """Answer with the model, which has a doubt about its crossing."""
    model = json.loads(route.fetch().body())
    doubt = occurrence("crossing-undecided") | {"chains": [0], "crossing": 0, "message": "crossing 0: not certain"}
    model["quality"] |= {"verdict": "review", "findings": [doubt]}
    route.fulfill(json=model)


def test_a_result_and_a_problem_are_shown_in_german(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed, locale="de-DE")
    opened.allow_errors("404")
    page = opened.page
    expect(page.get_by_role("button", name="STOPP Arm anhalten")).to_be_visible()
    expect(page.get_by_text("kein Not-Halt")).to_be_visible()
    page.route("**/model", with_a_doubt)
    page.keyboard.press("2")
    finding = page.get_by_role("region", name="Befunde").get_by_role("button")
    expect(finding).to_contain_text("Kreuzung 0 bei (300,0; -100,0; 1,5) mm: Welcher Strang oben liegt, ist nicht")
    expect(finding.locator("[lang=en]")).to_have_text("Crossing 0: not certain.")  # for the support
    expect(page.get_by_role("button", name=re.compile(r"Schnur 0: \d+ mm lang, \d+,\d mm dick"))).to_be_visible()
    page.evaluate("location.hash = '#/result/20260131t120000-000000-9f86d081'")
    expect(page.get_by_role("main")).to_contain_text("Diesen Scan gibt es nicht.")
    expect(page.get_by_role("main")).to_contain_text("Es gibt keinen Scan 20260131t120000-000000-9f86d081")


def test_a_person_chooses_the_language(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, locale="de-DE").page
    choice = page.get_by_role("combobox", name="Sprache")
    expect(choice.locator("option")).to_have_text(["Deutsch", "English", "日本語"])
    choice.select_option(label="日本語")
    expect(page.locator("html")).to_have_attribute("lang", "ja")
    expect(page.get_by_role("button", name="停止 アームを止める")).to_be_visible()
    expect(page.get_by_text("非常停止ではありません")).to_be_visible()
    expect(page.get_by_role("banner").get_by_role("status")).to_contain_text("接続されていません。")
    page.reload()
    expect(page.get_by_role("heading", name="スキャン", level=1)).to_be_visible()
    page.get_by_role("combobox", name="言語").select_option("en")
    expect(page.get_by_role("button", name="STOP the arm")).to_be_visible()


def check_layout(page: Page, stop: str) -> None:
    """Assert that all texts fit, and that STOP is in the first screen."""
    assert_texts_fit(page)
    box, size = page.get_by_role("button", name=stop).bounding_box(), page.viewport_size
    assert box is not None
    assert size is not None
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= size["height"]


def resize(page: Page, size: tuple[int, int]) -> None:
    """Change the window, and wait until the page has followed."""
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


@pytest.mark.parametrize("tag", LANGUAGES)
def test_no_text_of_a_language_is_cut_or_covered(
    open_console: Open, cell: Cell, crossed: ServedClient, tag: str, tmp_path: Path
) -> None:
    """Every screen is opened once, and measured at each size."""
    cell.make_ready()
    texts = catalogue(tag)
    stop = f"{texts['stop']['button']} {texts['stop']['button_object']}"

    def check(page: Page, name: str) -> None:
        for size, pixels in SIZES.items():
            resize(page, pixels)
            try:
                check_layout(page, stop)
            except AssertionError:
                page.screenshot(path=tmp_path / f"{tag}-{name}-{size}.png")
                raise
        resize(page, SIZES["tablet"])

    page = open_console(cell.live.client, locale=tag).page
    expect(page.get_by_role("heading", name=texts["login"]["title"])).to_be_visible()
    check(page, "login")

    page = open_console(crossed, "#/history", locale=tag).page
    page.route("**/model", with_a_doubt)
    page.evaluate("location.hash = '#/result'")
    wait_until_drawn(page)
    check(page, "result")
    page.keyboard.press("3")
    expect(page.get_by_role("heading", name=texts["history"]["title"], level=1)).to_be_visible()
    page.get_by_role("list").get_by_role("button").first.click()
    check(page, "history")

    page = open_console(cell.live.client, "#/calibration", token=cell.tokens["maintainer"], locale=tag).page
    expect(page.get_by_role("heading", name=texts["calibration"]["title"], level=1)).to_be_visible()
    for summary in page.locator("main summary").all():
        summary.click()
    check(page, "calibration")
    page.evaluate("location.hash = '#/scan'")
    expect(page.get_by_text(texts["scan"]["reach"]["count"].format(reachable=8, planned=8))).to_be_visible()
    check(page, "scan")
    page.get_by_role("button", name=stop).click()
    expect(page.get_by_role("region", name=texts["stopped"]["region"])).to_be_visible()
    check(page, "stopped")
    cell.make_ready()
    cell.live.controller.emergency_stop()
    expect(page.get_by_role("region", name=texts["fault"]["region"])).to_be_visible()
    check(page, "fault")
    cell.make_ready()
