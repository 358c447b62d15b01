"""The page of a result: its 3D view and its text."""

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
from tests.service.console.conftest import Open, frame_count, wait_until_drawn
from tests.service.security.conftest import without_recognition

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes

Finished = Callable[[httpx2.Client, str], dict[str, Any]]
POINTS = 100_000


@pytest.fixture(scope="module")
def crossed(serve: Serve, finished: Finished, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """A service with one scan, whose string has one crossing."""
    file = tmp_path_factory.mktemp("recording") / "eight.mcap"
    write_simulation(simulate(make_scene("figure-eight", 1), camera_model("ideal", (320, 200)), 1, views=6), file)
    with serve(tmp_path_factory.mktemp("data")) as client:
        recording = client.post("/api/recordings", content=file.read_bytes()).json()["id"]
        answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
        assert finished(client, answer.headers["Location"])["summary"]["crossings"] == 1
        yield client


def original_model(crossed: ServedClient) -> dict[str, Any]:
    """Return the model of the oldest scan. The later ones repeat it with other methods."""
    return crossed.get(crossed.get("/api/scans").json()["scans"][-1]["links"]["model"]).json()


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
        model["grasps"][0]["clearance_m"] = MAX_RELEVANT_DISTANCE_M
        model["grasps"][1]["clearance_m"] = MAX_RELEVANT_DISTANCE_M - 0.0001
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


def test_a_finding_turns_the_view_to_its_position(open_console: Open, crossed: ServedClient) -> None:
    """The warning has the form that recognition uses; `tests/recognition` tests that form."""
    opened = open_console(crossed)
    page = opened.page
    where = "at (360, 0, 4) mm"
    warning = f"something of 12 mm {where} is above the table and in no chain"

    def with_finding(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["quality"]["warnings"] = [warning, "nothing that has a place"]
        route.fulfill(json=model)

    page.route("**/model", with_finding)
    page.keyboard.press("2")
    wait_until_drawn(page)
    expect(page.get_by_text("2 findings to read before you grasp")).to_be_visible()
    before = frame_count(page)
    page.get_by_role("button", name="Something of 12 mm").click()
    wait_until(lambda: frame_count(page) > before)
    expect(page.locator(".label3d.marked")).to_be_visible()


def test_the_page_reports_that_no_scan_has_a_result(open_console: Open, serve: Serve, tmp_path: Path) -> None:
    with without_recognition(serve, tmp_path) as client:
        page = open_console(client, "#/result").page
        expect(page.get_by_text("No scan has a result yet")).to_be_visible()
        page.close()  # before its service ends


def test_the_page_explains_why_no_string_was_found(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page
    warning = "no string of radius 15.0 mm found: nothing above the table is long, round and about as thick"

    def without_strings(route: Route) -> None:
        document = json.loads(route.fetch().body())
        if "chains" in document:
            document |= {"chains": [], "crossings": [], "grasps": []}
            document["quality"] |= {"warnings": [warning], "ambiguities": []}
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
        later = replace(new_scan("live", "graph", None, NOBODY), state="scanning")
        store.scans.add(later)
        store.scans.end(later.id, "failed", Failure("robot-lost", "the robot was lost"))
        page = open_console(client, "#/result").page
        wait_until_drawn(page)
        assert page.url.endswith(done["id"])
        expect(page.get_by_text("This is an earlier scan.")).to_be_visible()
        page.keyboard.press("1")
        expect(page.get_by_role("region", name="The last scan")).to_contain_text("0 views were recorded")
        page.close()  # before its service ends
