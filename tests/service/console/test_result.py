"""The page of a result: its 3D view and its text."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Locator, Page, Route, expect

from recognition.grasping.candidates import MAX_RELEVANT_DISTANCE_M
from recognition.request import RecognitionRequest
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.console.conftest import Finished, Open, frame_count, original_model, wait_until_drawn
from tests.service.security.conftest import without_recognition

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes

POINTS = 100_000


def test_the_page_shows_the_values_of_the_model(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    model = original_model(crossed)
    (crossing,) = model["crossings"]
    over, under = (f"{crossing[one]['s_m'] * 1000:.0f} mm" for one in ("over", "under"))
    expect(page.get_by_role("button", name=f"at {over} lies over string 0 at {under}")).to_be_visible()
    expect(page.locator(".label3d.crossing")).to_contain_text("over")
    expect(page.get_by_role("heading", name=f"The best 5 of {len(model['grasps'])} grasps")).to_be_visible()


def test_a_clearance_beyond_the_search_distance_is_shown_as_a_minimum(
    open_console: Open, crossed: ServedClient
) -> None:
    opened = open_console(crossed)
    page = opened.page

    def with_a_distant_obstacle(route: Route) -> None:
        model = json.loads(route.fetch().body())
        for grasp in model["grasps"]:
            grasp["clearance_m"] = MAX_RELEVANT_DISTANCE_M - (0.0 if grasp["id"] == 0 else 0.0001)
        route.fulfill(json=model)

    page.route("**/model", with_a_distant_obstacle)
    page.keyboard.press("2")
    expect(page.get_by_text(f"clearance {MAX_RELEVANT_DISTANCE_M * 1000:.0f} mm or more")).to_have_count(1)


def test_a_point_is_picked_and_read(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    for layer in ("Labels", "Crossings"):  # these can be picked too
        page.get_by_label(layer, exact=True).uncheck()
    model = original_model(crossed)
    page.get_by_role("button", name="From above").click()
    picked = page.get_by_role("region", name="Selected point")
    _pick_string(page, picked)
    chain = model["chains"][0]
    index = int(picked.get_by_role("heading").inner_text().rpartition(" ")[2])
    shown = picked.inner_text()
    assert f"({', '.join(f'{value * 1000:.1f}' for value in chain['points'][index])}) mm" in shown
    assert f"{chain['arc_length_m'][index] * 1000:.1f} mm of" in shown
    assert f"± {chain['sigma_m'][index] * 1000:.2f} mm" in shown
    picked.get_by_role("button", name="Next point").click()
    expect(picked.get_by_role("heading")).to_have_text(f"String 0, point {min(index + 1, len(chain['points']) - 1)}")


def _pick_string(page: Page, picked: Any) -> None:
    """Click along the horizontal centre line of the view until a string is picked."""
    box = page.locator("canvas").bounding_box()
    assert box is not None
    for share in np.linspace(0.5, 0.95, 60):
        for x in (share, 1 - share):
            page.mouse.click(box["x"] + box["width"] * x, box["y"] + box["height"] / 2)
            if picked.count():
                return
    pytest.fail("no click picked a string")


def test_layers_are_shown_and_hidden(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    expect(page.locator(".label3d.view")).to_have_count(0)
    page.get_by_label("Cameras").check()
    expect(page.locator(".label3d.view")).to_have_count(6)
    page.get_by_label("Labels").uncheck()
    expect(page.locator(".label3d.view").first).to_be_hidden()


def test_a_cloud_of_100000_points_is_rotated_by_keyboard(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page
    points = np.random.default_rng(1).uniform((0.25, -0.1, 0), (0.45, 0.1, 0.01), (POINTS, 3)).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {POINTS}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"

    def fulfil_with_points(route: Route) -> None:
        route.fulfill(body=head.encode() + points.tobytes(), content_type="application/octet-stream")

    page.route("**/cloud.ply", fulfil_with_points)
    page.keyboard.press("2")
    expect(page.locator(f'canvas[data-points="{POINTS}"]')).to_be_visible()
    wait_until_drawn(page)
    page.locator("canvas").focus()
    for key in ("ArrowLeft", "ArrowUp", "+", "0"):
        before = frame_count(page)
        page.keyboard.press(key)
        wait_until(lambda before=before: frame_count(page) > before)
    unchanged = frame_count(page)
    page.wait_for_timeout(300)
    assert frame_count(page) == unchanged  # an unchanged view is not drawn again


def test_methods_are_compared(open_console: Open, crossed: ServedClient, finished: Finished) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    page.get_by_role("button", name="enhanced: recognise").click()
    expect(page.get_by_role("button", name="enhanced: hide")).to_be_visible()
    row = page.get_by_role("row", name="enhanced")
    scan = crossed.get("/api/scans", params={"limit": 1}).json()["scans"][0]
    assert scan["method"] == "enhanced"
    model = crossed.get(scan["links"]["model"]).json()
    assert [cell.inner_text() for cell in row.get_by_role("cell").all()][:2] == [
        str(len(model["chains"])),
        str(len(model["crossings"])),
    ]
    page.get_by_role("button", name="enhanced: hide").click()
    expect(row).to_have_count(0)


VERDICTS = {
    "accept": ("good", "✓ Accept", "There are no doubts about this result."),
    "review": ("warn", "▲ Look first", "There are doubts about this result."),
    "refuse": ("bad", "⬣ Do not use", "This result must not be used"),
}
"""The style, the word and the meaning of each verdict."""


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_page_shows_the_verdict_and_the_most_serious_findings_first(
    open_console: Open, crossed: ServedClient, verdict: str
) -> None:
    page = open_console(crossed).page
    findings = [
        {"code": "sharp-bend", "severity": "blocking", "message": "one thing blocks"},
        {"code": "table-not-covered", "severity": "doubt", "message": "one thing is in doubt"},
        {"code": "more-pieces", "severity": "note", "message": "one thing was set aside"},
    ]
    first = {"accept": 2, "review": 1, "refuse": 0}[verdict]

    def with_verdict(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["quality"] |= {"verdict": verdict, "findings": findings[first:]}
        model["chains"][0] |= {"trust": verdict, "trusted_m": [(0.0, 0.1)]}
        model["crossings"][0]["trust"] = verdict
        route.fulfill(json=model)

    page.route("**/model", with_verdict)
    page.keyboard.press("2")
    shown = page.get_by_role("region", name="Verdict")
    tone, word, meaning = VERDICTS[verdict]
    expect(shown.locator(".badge")).to_have_text(word)
    expect(shown).to_have_class(f"verdict {tone}")
    expect(shown).to_contain_text(meaning)
    region = page.get_by_role("region", name="Findings")
    tops = [part.bounding_box() for part in (shown, region, page.get_by_role("heading", name="Strings"))]
    assert [top["y"] for top in tops if top] == sorted(top["y"] for top in tops if top)
    region.locator("summary", has_text="1 note").click()
    expect(region.locator("li")).to_have_text(
        ["One thing blocks.", "One thing is in doubt.", "One thing was set aside."][first:]
    )
    expect(region.get_by_role("button")).to_have_count(0)  # no finding has a position
    string = page.get_by_role("button", name=re.compile("^String 0: "))
    in_words = {"accept": "✓ no doubts", "review": "in doubt; 100 mm of", "refuse": "do not use"}[verdict]
    expect(string.locator(f".trust.{tone}")).to_contain_text(in_words)
    crossing = page.get_by_role("button", name="lies over")
    expect(crossing.locator(".trust")).to_have_count(0 if verdict == "accept" else 1)


@pytest.mark.parametrize("width", [1280, 390])
def test_a_finding_turns_the_view_to_its_position(open_console: Open, crossed: ServedClient, width: int) -> None:
    """The position comes from the members of a finding, not from its message. On a phone, the page scrolls to it."""
    page = open_console(crossed, width=width).page
    length_m = original_model(crossed)["chains"][0]["length_m"]
    marked = {
        "a crossing": ({"chains": [0], "crossing": 0, "point_m": (0.3, 0.0, 0.0)}, "0over"),
        "a part": ({"chains": [0], "s_range_m": (0.02, 0.05)}, "string 0, 20 mm to 50 mm"),
        "an end": ({"chains": [0], "end": "last"}, f"string 0 at {length_m * 1000:.1f} mm"),
        "a point": ({"point_m": (0.36, 0.0, 0.004)}, "(360.0, 0.0, 4.0) mm"),
        "a view": ({"chains": [0], "view": 2}, "view 2"),
    }
    without_position: dict[str, dict[str, Any]] = {
        "the whole model": {},
        "a chain that is not in the model": {"chains": [7]},
        "a view without a camera pose": {"view": 99},
    }
    findings = [
        {"code": "any", "severity": "doubt", "message": message} | members
        for message, members in ({name: members for name, (members, _) in marked.items()} | without_position).items()
    ]

    def with_findings(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["quality"] |= {"verdict": "review", "findings": findings}
        route.fulfill(json=model)

    page.route("**/model", with_findings)
    page.keyboard.press("2")
    wait_until_drawn(page)
    expect(page.get_by_role("heading", name="8 doubts to read before you grasp")).to_be_visible()
    region = page.get_by_role("region", name="Findings")
    expect(region.get_by_role("button")).to_have_count(len(marked))
    for message, (_, label) in marked.items():
        before = frame_count(page)
        region.get_by_role("button", name=f"{message.capitalize()}.", exact=True).click()
        wait_until(lambda before=before: frame_count(page) > before)
        expect(page.locator(".label3d.marked")).to_contain_text(label)
        assert is_uncovered(page, page.locator("canvas"))


def is_uncovered(page: Page, part: Locator) -> bool:
    """Return whether a part of the page is completely in the window and below the bar."""
    box, bar = part.bounding_box(), page.get_by_role("banner").bounding_box()
    assert box is not None
    assert bar is not None
    return bar["y"] + bar["height"] <= box["y"] and box["y"] + box["height"] <= page.evaluate("innerHeight")


def in_doubt(model: dict[str, Any]) -> dict[str, Any]:
    """Return a model with a doubt about all of it, and with one end that was not observed."""
    doubt = {"code": "table-not-covered", "severity": "doubt", "message": "one thing is in doubt"}
    chains = {"ends": ["unobserved", "free"], "trust": "review", "trusted_m": []}
    return model | {
        "chains": [chain | chains for chain in model["chains"]],
        "crossings": [crossing | {"trust": "review"} for crossing in model["crossings"]],
        "grasps": [grasp | {"trusted": False} for grasp in model["grasps"]],
        "quality": model["quality"] | {"verdict": "review", "findings": [doubt]},
    }


def test_a_result_in_doubt_marks_all_strings_and_grasps(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    page.route("**/model", lambda route: route.fulfill(json=in_doubt(json.loads(route.fetch().body()))))
    page.keyboard.press("2")
    wait_until_drawn(page)
    expect(page.get_by_role("region", name="Verdict").locator(".badge")).to_have_text("▲ Look first")
    string = page.get_by_role("button", name=re.compile("^String 0: "))
    expect(string).to_contain_text("ends unobserved and free")
    expect(string.locator(".trust.warn")).to_contain_text("in doubt; 0 mm of")
    expect(page.locator(".label3d.unobserved")).to_have_count(1)
    expect(page.locator(".targets .trust.good")).to_have_count(0)
    grasps = page.get_by_role("button", name=re.compile("fingers .* in doubt$"))
    expect(grasps).to_have_count(5)
    grasps.first.click()
    expect(page.locator(".label3d.marked")).to_have_text("grasp 0")


YELLOW, TABLE = (254, 232, 56), (211, 220, 227)
"""Colours of a height of 27 mm and of the table in the light scheme."""


def test_the_height_map_is_loaded_and_drawn_on_request(open_console: Open, crossed: ServedClient) -> None:
    """The map has four cells. From above: unmeasured and table; then table and a high one."""
    opened = open_console(crossed)
    page = opened.page

    def with_four_cells(route: Route) -> None:
        z_m = [[0.0, None], [0.03, 0.0004]]
        measured = json.loads(route.fetch().body()) | {"table_z_m": 0.0, "min_object_height_m": 0.0012}
        route.fulfill(json=measured | {"x_m": -0.05, "y_m": -0.05, "cell_m": 0.05, "z_m": z_m})

    page.route("**/height-map", with_four_cells)
    page.keyboard.press("2")
    wait_until_drawn(page)
    for layer in ("Strings", "Measured points", "Crossings", "Labels"):
        page.get_by_label(layer, exact=True).uncheck()
    page.get_by_role("button", name="From above").click()
    assert len(pixels(page, YELLOW)) == 0
    assert not [one for one in opened.requests if "height-map" in one.url]
    page.get_by_label("Height map").check()
    expect(page.get_by_text("Height above the table:")).to_contain_text("within 1.2 mm of it")
    wait_until(lambda: len(pixels(page, YELLOW)) > 0)
    yellow, table = pixels(page, YELLOW), pixels(page, TABLE)
    assert len(table) == pytest.approx(2 * len(yellow), rel=0.1)  # the view is a perspective one, nearly from above
    (x, y), (middle_x, middle_y) = yellow.mean(axis=0), table.mean(axis=0)
    assert x > middle_x + 20
    assert y > middle_y + 20  # pixels count downwards
    page.get_by_label("Height map").uncheck()
    wait_until(lambda: len(pixels(page, YELLOW)) == 0)
    expect(page.get_by_text("Height above the table:")).to_have_count(0)
    assert len([one for one in opened.requests if "height-map" in one.url]) == 1


def pixels(page: Page, colour: tuple[int, int, int]) -> np.ndarray:
    """Return the pixels (N, 2) of the 3D view that have a colour, as x and y."""
    image = np.asarray(Image.open(io.BytesIO(page.locator("canvas").screenshot())).convert("RGB"), dtype=np.int16)
    return np.argwhere((np.abs(image - colour) <= 3).all(axis=-1))[:, ::-1]


def test_the_height_map_is_not_offered_where_there_is_none(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page

    def without_height_map(route: Route) -> None:
        scan = json.loads(route.fetch().body())
        route.fulfill(json=scan | {"links": scan["links"] | {"height_map": None}})

    page.route(re.compile(r"/api/scans/[^/?]+$"), without_height_map)
    page.keyboard.press("2")
    wait_until_drawn(page)
    expect(page.get_by_label("Height map")).to_have_count(0)


def test_the_page_reports_that_no_scan_has_a_result(open_console: Open, serve: Serve, tmp_path: Path) -> None:
    with without_recognition(serve, tmp_path) as client:
        page = open_console(client, "#/result").page
        expect(page.get_by_text("No scan has a result yet")).to_be_visible()
        page.close()  # before its service ends


def test_the_page_explains_why_no_string_was_found(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page
    message = "no string of radius 15.0 mm found: nothing above the table is long, round and about as thick"
    finding = {"code": "no-string-found", "severity": "note", "message": message}

    def without_strings(route: Route) -> None:
        document = json.loads(route.fetch().body())
        if "chains" in document:
            document |= {"chains": [], "crossings": [], "grasps": []}
            document["quality"] |= {"verdict": "accept", "findings": [finding]}
        else:
            document |= {"string_radius_m": 0.015, "summary": document["summary"] | {"chains": 0, "crossings": 0}}
        route.fulfill(json=document)

    page.route(re.compile(r"/api/scans/[^/?]+(/model)?$"), without_strings)
    page.keyboard.press("2")
    expect(page.locator(".badge.warn", has_text="No string found")).to_be_visible()
    expect(page.get_by_role("heading", name="Why no string was found")).to_be_visible()
    expect(page.get_by_text("No string of radius 15.0 mm found")).to_be_visible()
    expect(page.get_by_text("Only a string with a radius of 15.0 mm was searched for")).to_be_visible()
    expect(page.get_by_label("Grasps", exact=True)).to_have_count(0)
    expect(page.get_by_label("Strings", exact=True)).to_have_count(0)


def test_the_newest_result_is_shown_when_later_scans_have_none(
    open_console: Open, serve: Serve, crossed: ServedClient, finished: Finished, tmp_path: Path
) -> None:
    recording = crossed.get(crossed.get("/api/recordings").json()["recordings"][0]["links"]["file"]).content
    with serve(tmp_path) as client:
        sent = client.post("/api/recordings", content=recording).json()["id"]
        request = {"mode": "replay", "recording": sent}
        done = finished(client, client.post("/api/scans", json=request).headers["Location"])
        store = client.app.state.context.store
        later = replace(new_scan("live", RecognitionRequest(), NOBODY), state="scanning")
        store.scans.add(later)
        store.scans.end(later.id, "failed", Failure("robot-lost", "the robot was lost"))
        page = open_console(client, "#/result").page
        wait_until_drawn(page)
        assert page.url.endswith(done["id"])
        expect(page.get_by_text("This is an earlier scan.")).to_be_visible()
        page.keyboard.press("1")
        expect(page.get_by_role("region", name="The last scan")).to_contain_text("0 views were recorded")
        page.close()  # before its service ends
