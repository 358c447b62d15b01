"""A result in 3D and in words."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.grasping.candidates import MAX_RELEVANT_DISTANCE_M
from service.errors import Failure
from service.jobs.submission import NOBODY, new_scan
from tests.service.conftest import Serve, ServedClient, wait_until
from tests.service.console.conftest import Open, drawn, frames
from tests.service.security.conftest import without_recognition

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: each is several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
POINTS = 100_000


@pytest.fixture(scope="module")
def crossed(serve: Serve, finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """A service with one scan, of a recording of a string that crosses itself."""
    file = tmp_path_factory.mktemp("recording") / "eight.mcap"
    write_simulation(simulate(make_scene("figure-eight", 1), camera_model("ideal", (320, 200)), 1, views=6), file)
    with serve(tmp_path_factory.mktemp("data")) as client:
        recording = client.post("/api/recordings", content=file.read_bytes()).json()["id"]
        answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
        assert finished(client, answer.headers["Location"])["summary"]["crossings"] == 1
        yield client


def test_what_is_said_is_what_the_model_says(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    drawn(page)
    model = crossed.get(crossed.get("/api/scans").json()["scans"][0]["links"]["model"]).json()
    (crossing,) = model["crossings"]
    over, under = (f"{crossing[one]['s_m'] * 1000:.0f} mm" for one in ("over", "under"))
    expect(page.get_by_role("button", name=f"at {over} lies over string 0 at {under}")).to_be_visible()
    expect(page.locator(".label3d.crossing")).to_contain_text("over")
    expect(page.get_by_role("heading", name=f"The best 5 of {len(model['grasps'])} grasps")).to_be_visible()


def test_what_was_not_looked_at_is_not_told(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page

    def with_one_free(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["grasps"][0]["clearance_m"] = MAX_RELEVANT_DISTANCE_M
        model["grasps"][1]["clearance_m"] = MAX_RELEVANT_DISTANCE_M - 0.0001
        route.fulfill(json=model)

    page.route("**/model", with_one_free)
    page.keyboard.press("2")
    expect(page.get_by_text(f"clearance {MAX_RELEVANT_DISTANCE_M * 1000:.0f} mm or more")).to_have_count(1)


def test_a_point_is_picked_and_read(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    drawn(page)
    for layer in ("Labels", "Crossings"):  # which can be picked too
        page.get_by_label(layer, exact=True).uncheck()
    model = crossed.get(crossed.get("/api/scans").json()["scans"][0]["links"]["model"]).json()
    page.get_by_role("button", name="From above").click()
    picked = page.get_by_role("region", name="Selected point")
    _pick(page, picked)
    chain = model["chains"][0]
    index = int(picked.get_by_role("heading").inner_text().rpartition(" ")[2])
    told = picked.inner_text()
    assert f"({', '.join(f'{value * 1000:.1f}' for value in chain['points'][index])}) mm" in told
    assert f"{chain['arc_length_m'][index] * 1000:.1f} mm of" in told
    assert f"± {chain['sigma_m'][index] * 1000:.2f} mm" in told
    picked.get_by_role("button", name="Next point").click()
    expect(picked.get_by_role("heading")).to_have_text(f"String 0, point {min(index + 1, len(chain['points']) - 1)}")


def _pick(page: Page, picked: Any) -> None:
    """Clicks along the picture's middle line until a string is met."""
    box = page.locator("canvas").bounding_box()
    assert box is not None
    for share in np.linspace(0.5, 0.95, 60):
        for x in (share, 1 - share):
            page.mouse.click(box["x"] + box["width"] * x, box["y"] + box["height"] / 2)
            if picked.count():
                return
    pytest.fail("no string was met")


def test_layers_are_shown_and_hidden(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    drawn(page)
    expect(page.locator(".label3d.view")).to_have_count(0)
    page.get_by_label("Cameras").check()
    expect(page.locator(".label3d.view")).to_have_count(6)
    page.get_by_label("Labels").uncheck()
    expect(page.locator(".label3d.view").first).to_be_hidden()


def test_a_hundred_thousand_points_are_turned_by_keys(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page
    points = np.random.default_rng(1).uniform((0.25, -0.1, 0), (0.45, 0.1, 0.01), (POINTS, 3)).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {POINTS}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"

    def many(route: Route) -> None:
        route.fulfill(body=head.encode() + points.tobytes(), content_type="application/octet-stream")

    page.route("**/cloud.ply", many)
    page.keyboard.press("2")
    expect(page.locator(f'canvas[data-points="{POINTS}"]')).to_be_visible()
    drawn(page)
    page.locator("canvas").focus()
    for key in ("ArrowLeft", "ArrowUp", "+", "0"):
        before = frames(page)
        page.keyboard.press(key)
        wait_until(lambda before=before: frames(page) > before)
    still = frames(page)
    page.wait_for_timeout(300)
    assert frames(page) == still  # nothing is drawn that has not changed


def test_methods_are_compared(open_console: Open, crossed: ServedClient, finished: Finished) -> None:
    page = open_console(crossed, "#/result").page
    drawn(page)
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


def test_findings_turn_the_view_to_their_place(open_console: Open, crossed: ServedClient) -> None:
    """As recognition words them: see `tests/recognition` for the words."""
    opened = open_console(crossed)
    page = opened.page
    where = "at (360, 0, 4) mm"
    words = f"something of 12 mm {where} is above the table and in no chain"

    def with_finding(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["quality"]["warnings"] = [words, "nothing that has a place"]
        route.fulfill(json=model)

    page.route("**/model", with_finding)
    page.keyboard.press("2")
    drawn(page)
    expect(page.get_by_text("2 findings to read before you grasp")).to_be_visible()
    before = frames(page)
    page.get_by_role("button", name="Something of 12 mm").click()
    wait_until(lambda: frames(page) > before)
    expect(page.locator(".label3d.marked")).to_be_visible()


def test_where_nothing_was_scanned_it_says_so(open_console: Open, serve: Serve, tmp_path: Path) -> None:
    with without_recognition(serve, tmp_path) as client:
        page = open_console(client, "#/result").page
        expect(page.get_by_text("No scan has a result yet")).to_be_visible()
        page.close()  # before its service goes


def test_where_no_string_was_found_it_says_why_and_offers_nothing(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page
    why = "no string of radius 15.0 mm found: nothing above the table is long, round and about as thick"

    def without_strings(route: Route) -> None:
        told = json.loads(route.fetch().body())
        if "chains" in told:
            told |= {"chains": [], "crossings": [], "grasps": []}
            told["quality"] |= {"warnings": [why], "ambiguities": []}
        else:
            told |= {"string_radius_m": 0.015, "summary": told["summary"] | {"chains": 0, "crossings": 0}}
        route.fulfill(json=told)

    page.route(re.compile(r"/api/scans/[^/?]+(/model)?$"), without_strings)
    page.keyboard.press("2")
    expect(page.locator(".badge.warn", has_text="No string found")).to_be_visible()
    expect(page.get_by_role("heading", name="Why no string was found")).to_be_visible()
    expect(page.get_by_text("No string of radius 15.0 mm found")).to_be_visible()
    expect(page.get_by_text("Only a string with a radius of 15.0 mm was searched for")).to_be_visible()
    expect(page.get_by_label("Grasps", exact=True)).to_have_count(0)
    expect(page.get_by_label("Strings", exact=True)).to_have_count(0)


def test_the_newest_result_is_shown_though_later_scans_have_none(
    open_console: Open, serve: Serve, crossed: ServedClient, finished: Finished, tmp_path: Path
) -> None:
    recording = crossed.get(crossed.get("/api/recordings").json()["recordings"][0]["links"]["file"]).content
    with serve(tmp_path) as client:
        sent = client.post("/api/recordings", content=recording).json()["id"]
        asked = {"mode": "replay", "recording": sent}
        done = finished(client, client.post("/api/scans", json=asked).headers["Location"])
        store = client.app.state.context.store
        later = replace(new_scan("live", "graph", None, NOBODY), state="scanning")
        store.scans.add(later)
        store.scans.end(later.id, "failed", Failure("robot-lost", "the robot was lost"))
        page = open_console(client, "#/result").page
        drawn(page)
        assert page.url.endswith(done["id"])
        expect(page.get_by_text("This is an earlier scan.")).to_be_visible()
        page.keyboard.press("1")
        expect(page.get_by_role("region", name="The last scan")).to_contain_text("0 views were recorded")
        page.close()  # before its service goes
