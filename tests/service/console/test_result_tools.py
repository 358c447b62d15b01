"""The tools of the page of a result: measuring, copying, changes, view pictures and files."""

import csv
import io
import json
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Locator, Page, Route, expect

from cell.simulation.offline_scan import simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import StringScene, make_scene
from recognition.request import RecognitionRequest
from service.api.response_cache import MAX_AGE_S
from service.interchange.point_files import to_csv
from service.jobs.submission import NOBODY, new_scan
from service.storage.data_folder import MODEL
from tests.service.conftest import Serve, ServedClient
from tests.service.console.conftest import Finished, Open, original_model, wait_until_drawn
from tests.service.console.test_accessibility import assert_usable

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes


def download(page: Page, button: Locator) -> tuple[str, bytes]:
    """Press a button or a link, and return the name and the content of the file that it saves."""
    with page.expect_download() as downloaded:
        button.click()
    return downloaded.value.suggested_filename, Path(downloaded.value.path()).read_bytes()


def test_all_files_of_a_result_are_saved(open_console: Open, crossed: ServedClient) -> None:
    scan = crossed.get("/api/scans").json()["scans"][-1]
    page = open_console(crossed, f"#/result/{scan['id']}").page
    wait_until_drawn(page)
    files = page.get_by_role("region", name="Files")
    for name, link, ending in (
        ("Model (JSON)", "model", ".json"),
        ("Grasps (JSON)", "grasps", "-grasps.json"),
        ("Points (PLY)", "cloud", ".ply"),
        ("Recording (MCAP)", "recording", ".mcap"),
    ):
        content = crossed.get(scan["links"][link]).content
        assert download(page, files.get_by_role("link", name=name)) == (f"{scan['id']}{ending}", content)

    name, table = download(page, files.get_by_role("button", name="Centre lines (CSV)"))
    assert name == f"{scan['id']}-simulated-centre-lines.csv"
    expected = to_csv(original_model(crossed))
    assert rows(table)[0] == rows(expected)[0]
    np.testing.assert_array_equal(numbers(table), numbers(expected))

    save_picture = files.get_by_role("button", name="Picture as shown (PNG)")
    name, with_labels = download(page, save_picture)
    assert name == f"{scan['id']}-simulated.png"
    page.locator("canvas").scroll_into_view_if_needed()
    shown = page.locator("canvas").screenshot()
    page.get_by_label("Labels", exact=True).uncheck()
    _, without_labels = download(page, save_picture)
    assert difference(with_labels, shown) < 0.3 * difference(without_labels, shown)
    picture = Image.open(io.BytesIO(with_labels)).convert("RGB")
    caption = picture.crop((0, Image.open(io.BytesIO(shown)).height, picture.width, picture.height))
    colours = {colour for _, colour in caption.getcolors(caption.width * caption.height) or []}
    assert (255, 212, 0) in colours  # the mark of a simulated cell


def difference(saved: bytes, shown: bytes) -> float:
    """Return the share of a picture that differs, in steps of 8 pixels: texts may be a pixel apart.

    The saved picture has a caption below.
    """
    size = (80, 40)
    area = Image.open(io.BytesIO(shown)).size
    both = [Image.open(io.BytesIO(one)).crop((0, 0, *area)).convert("L") for one in (saved, shown)]
    images = [one.resize(size, Image.Resampling.BOX) for one in both]
    first, second = (np.asarray(one, dtype=np.int16) for one in images)
    return float(np.mean(np.abs(first - second) > 20))


def rows(table: bytes) -> list[list[str]]:
    """Return the rows of a CSV file."""
    return list(csv.reader(io.StringIO(table.decode(), newline="")))


def numbers(table: bytes) -> NDArray[np.float64]:
    """Return the numbers of a CSV file without its header."""
    return np.array(rows(table)[1:], dtype=np.float64)


def with_ends(page: Page, closed: bool = False) -> None:
    """Give the model a finding about each end, so that the ends can be selected by keyboard."""
    ends = [
        {"code": "any", "severity": "doubt", "message": end, "chains": [0], "end": end} for end in ("first", "last")
    ]

    def answer(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["quality"] |= {"verdict": "review", "findings": ends}
        model["chains"][0]["closed"] = closed
        route.fulfill(json=model)

    page.route("**/model", answer)
    page.keyboard.press("2")
    wait_until_drawn(page)


def test_a_distance_is_measured_by_keyboard(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    model = original_model(crossed)
    chain, crossing = model["chains"][0], model["crossings"][0]
    points, sigma_m = np.array(chain["points"]), chain["sigma_m"]
    page.get_by_role("button", name=re.compile("^String 0: ")).press("Enter")
    page.get_by_role("button", name="Select its first point").press("Enter")
    page.get_by_role("button", name="Measure from here").press("Enter")
    measurement = page.get_by_role("region", name="Measurement")
    expect(measurement).to_contain_text("From: String 0, point 0. Now select the second point")
    expect(page.locator(".label3d.measured")).to_have_text("measured from here")
    page.get_by_role("button", name="10 points on").press("Enter")
    page.get_by_role("button", name="Next point").press("Enter")
    x, y, z = points[11] - points[0]
    distance = f"{np.linalg.norm([x, y, z]) * 1000:.1f} mm"
    for text in (
        "To: String 0, point 11.",
        f"{distance} ± {np.hypot(sigma_m[0], sigma_m[11]) * 1000:.2f} mm",
        f"x {x * 1000:.1f} mm, y {y * 1000:.1f} mm, z {z * 1000:.1f} mm",
        f"Along the string\n{chain['arc_length_m'][11] * 1000:.1f} mm",
    ):
        assert text in measurement.inner_text().replace("\n\n", "\n")
    expect(page.locator(".label3d.measured")).to_have_text(distance)

    page.get_by_role("button", name="lies over").press("Enter")
    to_crossing = np.linalg.norm(np.array(crossing["point"]) - points[0])
    expect(measurement).to_contain_text(f"{to_crossing * 1000:.1f} mm")
    expect(measurement).not_to_contain_text("Along the string")
    page.get_by_role("button", name="End the measurement").press("Enter")
    expect(page.locator(".label3d.measured")).to_have_count(0)


def test_a_ring_has_two_lengths_between_two_points(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    with_ends(page, closed=True)
    chain = original_model(crossed)["chains"][0]
    page.get_by_role("button", name="First.").click()
    page.get_by_role("button", name="Measure from here").click()
    for _ in range(3):
        page.get_by_role("button", name="Next point").click()
    near = chain["arc_length_m"][3]
    far = chain["length_m"] - near
    measurement = page.get_by_role("region", name="Measurement")
    expect(measurement).to_contain_text(f"{near * 1000:.1f} mm, or {far * 1000:.1f} mm the other way round")


def test_measured_points_and_heights_are_picked(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    for layer in ("Strings", "Crossings", "Labels"):
        page.get_by_label(layer, exact=True).uncheck()
    page.get_by_role("button", name="From above").click()
    cloud = crossed.get(crossed.get("/api/scans").json()["scans"][-1]["links"]["cloud"]).content
    points = np.frombuffer(cloud.partition(b"end_header\n")[2], dtype="<f4").reshape(-1, 3)
    picked = pick(page, "Measured point")
    assert np.linalg.norm(points - picked, axis=1).min() < 1e-4
    page.get_by_label("Measured points", exact=True).uncheck()
    page.get_by_label("Height map").check()
    expect(page.get_by_text("Height above the table:")).to_be_visible()
    page.get_by_role("button", name="Deselect").click()
    x, y, z = pick(page, "Measured point")
    heights = crossed.get(crossed.get("/api/scans").json()["scans"][-1]["links"]["height_map"]).json()
    column, row = int((x - heights["x_m"]) / heights["cell_m"]), int((y - heights["y_m"]) / heights["cell_m"])
    assert heights["z_m"][column][row] == pytest.approx(z, abs=1e-4)


def pick(page: Page, name: str) -> NDArray[np.float64]:
    """Click along a line of the view until something is selected; return its position, metres."""
    box = page.locator("canvas").bounding_box()
    assert box is not None
    panel = page.get_by_role("region", name="Selected point")
    for share in np.linspace(0.3, 0.7, 60):
        page.mouse.click(box["x"] + box["width"] * share, box["y"] + box["height"] * 0.45)
        if panel.count():
            expect(panel.get_by_role("heading")).to_contain_text(name)
            return np.array(re.findall(r"-?\d+\.\d", panel.locator("dd").first.inner_text()), dtype=float) / 1000
    pytest.fail(f"no click selected a {name}")


def copied(page: Page, region: str) -> dict[str, Any]:
    """Copy the JSON of a region, and return what a person can then paste."""
    return json.loads(pasted_after(page, region, "Copy as JSON"))


def pasted_after(page: Page, region: str, button: str) -> str:
    """Press the button of a region that copies, and return what a person can then paste."""
    part = page.get_by_role("region", name=region)
    part.get_by_role("button", name=button).click()
    expect(part.get_by_role("status")).to_have_text("✓ Copied")
    page.evaluate("() => document.body.append(Object.assign(document.createElement('textarea'), {id: 'paste'}))")
    page.locator("#paste").press("ControlOrMeta+v")
    pasted = page.locator("#paste").input_value()
    page.evaluate("() => document.querySelector('#paste').remove()")
    return pasted


@pytest.mark.parametrize("clipboard", [True, False])
def test_a_position_and_a_grasp_are_copied(open_console: Open, crossed: ServedClient, clipboard: bool) -> None:
    """A page of `http://cell:8000` has no `navigator.clipboard`."""
    page = open_console(crossed).page
    if clipboard:
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    else:
        page.evaluate("() => Object.defineProperty(navigator, 'clipboard', {value: undefined})")
    joints = [0.1, -1.2, 1.3, 0.0, 0.5, 0.0]

    def with_reach(route: Route) -> None:
        document = json.loads(route.fetch().body())
        reach = {"reachable": True, "path_free": True, "reason": None, "message": None}
        for grasp in document["grasps"]:
            grasp["reach"] = reach | {"q_pregrasp_rad": joints, "q_grasp_rad": joints[::-1]}
        route.fulfill(json=document)

    page.route(re.compile("/grasps([?]|$)"), with_reach)
    with_ends(page)
    model = original_model(crossed)
    chain, crossing, grasp = model["chains"][0], model["crossings"][0], model["grasps"][0]
    base = {"scan": model["provenance"]["scan"], "frame": "base"}
    page.get_by_role("button", name="Last.").click()
    last = len(chain["points"]) - 1
    assert copied(page, "Selected point") == base | {
        "chain": 0,
        "index": last,
        "s_m": chain["arc_length_m"][last],
        "point_m": chain["points"][last],
        "sigma_m": chain["sigma_m"][last],
    }
    in_mm = ", ".join(f"{1000 * value:.1f}" for value in chain["points"][last])
    assert pasted_after(page, "Selected point", "Copy position (mm)") == in_mm
    page.get_by_role("button", name="lies over").click()
    position = copied(page, "Selected point")
    assert position | base == position
    assert (position["point_m"], position["over"]) == (crossing["point"], crossing["over"])
    page.get_by_role("button", name=re.compile("^0: string .* fingers")).click()
    pose = copied(page, "Selected grasp")
    assert pose | base == pose
    for member in ("T_base_grasp", "T_base_flange", "s_m", "opening_m", "trusted"):
        assert pose[member] == grasp[member]
    assert (pose["reachable"], pose["q_pregrasp_rad"], pose["q_grasp_rad"]) == (True, joints, joints[::-1])


def test_a_text_that_cannot_be_copied_is_selected_for_the_person(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    page.evaluate("() => Object.defineProperty(navigator, 'clipboard', {value: undefined})")
    page.evaluate("() => { document.execCommand = () => false; }")
    with_ends(page)
    page.get_by_role("button", name="First.").click()
    page.get_by_role("button", name="Copy as JSON").first.click()
    field = page.get_by_label("press Ctrl+C")
    expect(field).to_be_focused()
    assert page.evaluate("() => getSelection().toString()") == field.input_value()
    assert json.loads(field.input_value())["point_m"] == original_model(crossed)["chains"][0]["points"][0]
    expect(page.get_by_text("✓ Copied")).to_have_count(0)


def test_a_view_picture_shows_its_camera_and_its_quality(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page

    def with_an_unused_view(route: Route) -> None:
        model = json.loads(route.fetch().body())
        model["quality"]["views"][5] |= {"used": False, "reason": "it contradicts the others", "rms_m": None}
        route.fulfill(json=model)

    page.route("**/model", with_an_unused_view)
    page.keyboard.press("2")
    wait_until_drawn(page)
    assert not [one for one in opened.requests if re.search(r"/views/\d+\.png", one.url)]  # not before they are shown
    page.get_by_text("Pictures of 6 views").click()
    pictures = page.locator(".view-pictures img")
    expect(pictures).to_have_count(6)
    quality = original_model(crossed)["quality"]["views"][2]
    page.get_by_role("button", name="View 2").click()
    expect(page.locator(".label3d.marked")).to_have_text("view 2")
    selected = page.get_by_role("region", name="Selected view")
    for text in (
        "Usedyes",
        f"Points above the table{quality['points']}",
        f"RMS{quality['rms_m'] * 1000:.2f} mm",
        f"moved by {quality['correction_m'] * 1000:.2f} mm",
    ):
        expect(selected).to_contain_text(text)
    page.get_by_role("button", name="View 5, not used").click()
    expect(selected).to_contain_text("no. It contradicts the others.")
    expect(selected).not_to_contain_text("RMS")


def scanned(client: ServedClient, scene: StringScene, file: Path, finished: Finished) -> dict[str, Any]:
    """Simulate views of a scene, and return the scan that recognises them."""
    write_simulation(simulate(scene, camera_model("exact", (320, 200)), 1, views=6), file)
    recording = client.post("/api/recordings", content=file.read_bytes()).json()["id"]
    started = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    return finished(client, started.headers["Location"])


def test_the_changes_since_an_earlier_scan_are_listed_and_drawn(
    open_console: Open, serve: Serve, finished: Finished, tmp_path: Path
) -> None:
    """The first string was moved, and the second one was taken away. A live scan may be of another table."""
    two = make_scene("several", 2, strings=2, crossings=1)
    cos, sin = np.cos(0.3), np.sin(0.3)
    moved = two.curves[0] @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + [0.02, 0.015, 0]
    with serve(tmp_path / "data") as client:
        before = scanned(client, two, tmp_path / "before.mcap", finished)
        store = client.app.state.context.store
        live = replace(new_scan("live", RecognitionRequest(), NOBODY), state="succeeded", summary=before["summary"])
        store.scans.add(live)
        now = scanned(client, replace(two, curves=(moved,), radii_m=()), tmp_path / "now.mcap", finished)
        since = client.get(now["links"]["model"], params={"since": before["id"]}).json()["since"]
        (match,), (gone,) = since["matches"], since["gone"]
        opened = open_console(client, f"#/result/{now['id']}")
        page = opened.page
        wait_until_drawn(page)
        changes = page.get_by_role("region", name="Changes since an earlier scan")
        choice = page.get_by_label("Earlier scan", exact=True)
        expect(choice.locator("option")).to_have_count(2)
        choice.select_option(before["id"])
        entries = changes.get_by_role("button")
        expect(entries).to_have_text(
            [
                re.compile(f"^String {match['chain']} moved by up to {match['displacement_m'] * 1000:.0f} mm."),
                f"String {gone} of the earlier scan is gone. ",
            ]
        )
        expect(changes.locator(".badge")).to_be_visible()  # the outcome of the earlier scan
        expect(page.locator(".label3d.earlier")).to_have_count(2)
        without_mark = page.locator("canvas").screenshot()
        entries.nth(1).press("Enter")
        page.get_by_role("button", name="All", exact=True).click()
        assert difference(page.locator("canvas").screenshot(), without_mark) > 0.01

        choice.select_option("")
        expect(page.locator(".label3d.earlier")).to_have_count(0)
        (store.folder.results(before["id"]) / MODEL).write_bytes(b"{")
        time.sleep(MAX_AGE_S)  # until the cached answer expires
        opened.allow_errors("500")
        choice.select_option(before["id"])
        expect(changes.get_by_role("alert")).to_contain_text("pointchain doctor")
        page.close()  # before its service ends


def test_all_tools_are_accessible_on_a_phone(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, scheme="dark", width=390).page
    page.evaluate("() => Object.defineProperty(navigator, 'clipboard', {value: undefined})")
    page.evaluate("() => { document.execCommand = () => false; }")
    with_ends(page)
    page.get_by_label("Height map").check()
    page.get_by_text("Pictures of 6 views").click()
    page.get_by_role("button", name="First.").click()
    page.get_by_role("button", name="Measure from here").click()
    page.get_by_role("button", name="Next point").click()
    page.get_by_role("button", name="Copy as JSON").first.click()
    expect(page.get_by_label("press Ctrl+C")).to_be_focused()
    expect(page.locator(".view-pictures img")).to_have_count(6)
    assert_usable(page)
    page.get_by_role("button", name=re.compile("^0: string .* fingers")).click()
    expect(page.locator(".label3d.motion")).to_have_text("pre-grasp and retreat")
    expect(page.locator("canvas")).to_be_in_viewport(ratio=1)
    page.get_by_role("button", name="Details of grasp 0").click()
    expect(page.get_by_role("region", name="Selected grasp").get_by_text("Reach")).to_be_in_viewport()
    assert_usable(page)
