"""The grasps of a result: their list, their reach, and the picture of the selected one."""

import io
import json
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page, Route, expect

from tests.service.conftest import ServedClient, wait_until
from tests.service.console.conftest import Open, frame_count, original_model, wait_until_drawn

pytestmark = pytest.mark.xdist_group("console")  # one at a time: each test runs several busy processes

LENGTH_M, DEPTH_M, PALM_M, FLANGE_M, APPROACH_M = 0.2, 0.04, 0.006, 0.006, 0.06
GRIPPER = {
    "finger_width_m": 0.01,
    "finger_thickness_m": 0.0075,
    "finger_depth_m": DEPTH_M,
    "stroke_m": 0.085,
    "palm_width_m": 0.03,
    "length_m": LENGTH_M,
    "mounting_rotation_rad": 0.0,
    "body_m": [[[-0.045, -0.03, 0.0], [0.045, 0.03, 0.05]]],
}
"""A gripper whose sizes across and along the string differ."""


def test_a_pressed_grasp_is_selected_in_the_list_and_in_the_view(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    wait_until_drawn(page)
    grasps = listed(original_model(crossed)["grasps"])
    entries = page.get_by_role("button", name=re.compile(r"fingers .* apart"))
    expect(entries).to_have_count(len(grasps))
    entries.nth(0).press("Enter")
    selected = page.get_by_role("region", name="Selected grasp")
    grasp = grasps[0]
    for text in (
        f"0, at {grasp['s_m'] * 1000:.1f} mm of",
        f"{grasp['clearance_m'] * 1000:.1f} mm",
        f"{grasp['end_distance_m'] * 1000:.0f} mm to the nearest end",
        f"{grasp['over_distance_m'] * 1000:.0f} mm to where it lies over",
        f"{grasp['under_distance_m'] * 1000:.0f} mm to where it lies under",
        f"({', '.join(f'{row[3] * 1000:.1f}' for row in grasp['T_base_grasp'][:3])}) mm",
        "not determined",
    ):
        expect(selected).to_contain_text(text)
    expect(page.locator(".label3d.marked")).to_have_text(f"grasp {grasp['id']}")
    expect(page.locator(".label3d.motion")).to_have_text("pre-grasp and retreat")  # both are 60 mm back

    page.get_by_role("button", name="From above").click()
    other = page.locator(".label3d.grasp:not(.crowded)").first
    name = other.inner_text()
    box = other.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    expect(page.locator(".label3d.marked")).to_have_text(name)
    expect(page.locator(".label3d.grasp", has_text=name)).to_have_count(0)  # it is drawn as the selected one
    pressed = page.get_by_role("button", pressed=True).and_(entries)
    expect(pressed).to_have_text(re.compile(rf"^{name.removeprefix('grasp ')}: string 0 at"))
    expect(selected).to_be_in_viewport()
    pressed.click()
    expect(pressed).to_have_count(0)
    expect(page.locator(".label3d.motion")).to_have_count(0)


def listed(grasps: list[dict[str, Any]], count: int = 5) -> list[dict[str, Any]]:
    """Return the best grasp of each of the first clusters."""
    best = {grasp["cluster"]: grasp for grasp in reversed(grasps)}
    return sorted(best.values(), key=lambda grasp: grasp["id"])[:count]


def test_the_selected_grasp_says_what_the_arm_reaches_and_what_a_lift_meets(
    open_console: Open, crossed: ServedClient
) -> None:
    page = open_console(crossed).page
    ids = [grasp["id"] for grasp in listed(original_model(crossed)["grasps"])]
    reached = {"reachable": True, "path_free": True, "reason": None, "message": None}
    refused = {"reachable": False, "path_free": None, "reason": "joint-limit", "message": "a joint would go too far"}
    reach = {ids[0]: reached, ids[1]: reached | {"path_free": False}, ids[2]: refused}
    above = {ids[0]: ([], None), ids[1]: ([0, 7], None), ids[2]: ([], 0.0234)}
    texts = {
        ids[0]: ["the arm reaches it", "nothing lies over the string"],
        ids[1]: ["something is in the way", "takes a part of the same string along", "takes string 7 along"],
        ids[2]: ["does not reach it: A joint would go too far.", "touches an object 23 mm above the grasp"],
    }

    def with_members(route: Route) -> None:
        document = json.loads(route.fetch().body())
        for grasp in document["grasps"]:
            if "reach" in grasp:
                grasp["reach"] = reach.get(grasp["id"])
            grasp["chains_above"], grasp["object_above_m"] = above.get(grasp["id"], ([], None))
        route.fulfill(json=document)

    page.route(re.compile("/(model|grasps)([?]|$)"), with_members)
    page.keyboard.press("2")
    entries = page.get_by_role("button", name=re.compile(r"fingers .* apart"))
    expect(page.get_by_role("button", name="the arm does not reach it")).to_have_text(re.compile(f"^{ids[2]}: "))
    for place, expected in enumerate(texts.values()):
        entries.nth(place).click()
        for text in expected:
            expect(page.get_by_role("region", name="Selected grasp")).to_contain_text(text)


@pytest.mark.parametrize(
    ("closing_along_x", "palm_m", "body_m"),
    [pytest.param(True, 0.1, 0.09, id="across the string"), pytest.param(False, 0.03, 0.06, id="along the string")],
)
def test_the_picture_shows_palm_and_body_of_the_configured_gripper(
    open_console: Open, crossed: ServedClient, closing_along_x: bool, palm_m: float, body_m: float
) -> None:
    """The recording of a replay may be from another cell, but its grasps are for the gripper of this one."""
    page = open_console(crossed).page
    show_grasp(page, GRIPPER, closing_along_x=closing_along_x)
    page.get_by_role("button", name="From the side").click()
    drawn = drawn_by_selection(page)
    rows = np.flatnonzero(drawn.any(axis=1))
    per_m = (rows[-1] - rows[0]) / (LENGTH_M + APPROACH_M + FLANGE_M)

    def width_m(above_tips_m: float) -> float:
        """Return the width of what is drawn at a height, without the arrows beside it."""
        row = drawn[int(rows[-1] - above_tips_m * per_m)]
        columns = np.flatnonzero(row)
        middle = columns.mean()
        gaps = np.flatnonzero(np.diff(columns) > 2)
        pieces = np.split(columns, gaps + 1)
        return max(np.ptp(piece) for piece in pieces if piece[0] - 1 <= middle <= piece[-1] + 1) / per_m

    assert width_m(DEPTH_M + PALM_M / 2) == pytest.approx(palm_m, rel=0.1)
    assert width_m(LENGTH_M + APPROACH_M - 0.02) == pytest.approx(body_m, rel=0.1)


def test_a_gripper_without_a_body_has_a_rod_to_the_flange(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    show_grasp(page, GRIPPER | {"body_m": []})
    page.get_by_role("button", name="From the side").click()
    drawn = drawn_by_selection(page)
    rows = np.flatnonzero(drawn.any(axis=1))
    per_m = (rows[-1] - rows[0]) / (LENGTH_M + APPROACH_M + FLANGE_M)
    columns = np.flatnonzero(drawn[int(rows[0] + 0.03 * per_m)])
    assert 0.002 < np.ptp(columns) / per_m < 0.01


def test_a_press_shows_the_gripper_up_to_the_flange(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    show_grasp(page, GRIPPER)
    drawn = drawn_by_selection(page)
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    assert rows[0] > 5
    assert rows[-1] < len(drawn) - 6
    assert columns[0] > 5
    assert columns[-1] < drawn.shape[1] - 6
    assert rows[-1] - rows[0] > len(drawn) / 2


def test_pre_grasp_and_retreat_are_labelled_at_their_flanges(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    show_grasp(page, GRIPPER, pregrasp_m=0.12)
    page.get_by_role("button", name="From the side").click()
    y = {}
    for name in ("pre-grasp", "retreat"):
        box = page.locator(".label3d.motion").get_by_text(name, exact=True).bounding_box()
        assert box is not None
        y[name] = box["y"] + box["height"] / 2
    marked = page.locator(".label3d.marked").bounding_box()
    assert marked is not None
    assert y["pre-grasp"] < y["retreat"] < marked["y"]
    ratio = (marked["y"] - y["pre-grasp"]) / (marked["y"] - y["retreat"])
    heights_m = [LENGTH_M - DEPTH_M + distance_m for distance_m in (0.12, APPROACH_M)]
    assert ratio == pytest.approx(heights_m[0] / heights_m[1], rel=0.15)


def test_no_motion_is_drawn_for_another_gripper(open_console: Open, crossed: ServedClient) -> None:
    """The gripper of the scan differs from the configured one in any dimension, such as its palm."""
    page = open_console(crossed).page

    def of_another_gripper(route: Route) -> None:
        route.fulfill(json=json.loads(route.fetch().body()) | {"same_gripper": False})

    page.route(re.compile("/grasps([?]|$)"), of_another_gripper)
    show_grasp(page, GRIPPER)
    expect(page.get_by_text("These grasps are for another gripper than the configured one.")).to_be_visible()
    expect(page.get_by_role("button", name="Check the reach")).to_have_count(0)
    expect(page.get_by_role("region", name="Selected grasp")).to_contain_text("not drawn: it is for another gripper")
    expect(page.locator(".label3d.marked")).to_contain_text("grasp 0opening")
    expect(page.locator(".label3d.motion")).to_have_count(0)


def test_no_motion_is_drawn_for_a_gripper_of_another_length(open_console: Open, crossed: ServedClient) -> None:
    """The service may not know the gripper of a scan, but the flange poses of its grasps show the length."""
    page = open_console(crossed).page
    show_grasp(page, GRIPPER | {"length_m": LENGTH_M + 0.02}, planned_length_m=LENGTH_M)
    expect(page.locator(".label3d.marked")).to_contain_text("grasp 0opening")
    expect(page.locator(".label3d.motion")).to_have_count(0)


def show_grasp(
    page: Page,
    gripper: dict[str, Any],
    *,
    closing_along_x: bool = True,
    pregrasp_m: float = APPROACH_M,
    planned_length_m: float | None = None,
) -> None:
    """Select the first grasp, made vertical and for this gripper, and hide everything else."""

    def with_gripper(route: Route) -> None:
        geometry = json.loads(route.fetch().body())
        route.fulfill(json=geometry | {"gripper": geometry["gripper"] | gripper})

    def with_vertical_grasp(route: Route) -> None:
        model = json.loads(route.fetch().body())
        grasp = model["grasps"][0]
        down = np.diag((1.0, -1.0, -1.0, 1.0)) if closing_along_x else np.eye(4)[[1, 0, 2, 3]] * (1, 1, -1, 1)
        down[:3, 3] = np.array(grasp["T_base_grasp"])[:3, 3]
        length_m = gripper["length_m"] if planned_length_m is None else planned_length_m

        def flange(back_m: float) -> list[list[float]]:
            pose = down.copy()
            pose[2, 3] += length_m - grasp["reach_m"] + back_m
            return pose.tolist()

        poses = {"pregrasp": flange(pregrasp_m), "grasp": flange(0.0), "retreat": flange(APPROACH_M)}
        grasp |= {"T_base_grasp": down.tolist(), "T_base_flange": poses}
        route.fulfill(json=model)

    page.route("**/api/cell/geometry", with_gripper)
    page.route("**/model", with_vertical_grasp)
    page.reload()
    page.keyboard.press("2")
    wait_until_drawn(page)
    page.get_by_role("button", name=re.compile("^0: .* apart")).click()
    expect(page.get_by_label("Grasps", exact=True)).to_be_checked()
    for layer in ("Strings", "Measured points", "Crossings", "Grasps"):
        page.get_by_label(layer, exact=True).uncheck()


def drawn_by_selection(page: Page) -> NDArray[np.bool_]:
    """Return the pixels (rows, columns) of the 3D view that the selected grasp changes. Deselects it."""

    def picture() -> NDArray[np.int16]:
        image = Image.open(io.BytesIO(page.locator("canvas").screenshot()))
        return np.asarray(image.convert("RGB"), dtype=np.int16)

    page.get_by_label("Labels", exact=True).uncheck()
    wait_until_unchanged(page)
    selected = picture()
    before = frame_count(page)
    page.get_by_role("button", pressed=True).click()
    wait_until(lambda: frame_count(page) > before)
    wait_until_unchanged(page)
    return np.asarray((np.abs(selected - picture()) > 2).any(axis=-1))


def wait_until_unchanged(page: Page) -> None:
    """Wait until the 3D view is not drawn any more."""
    counts = [-1]

    def is_unchanged() -> bool:
        page.wait_for_timeout(200)
        counts.append(frame_count(page))
        return counts[-1] == counts[-2]

    wait_until(is_unchanged)


def test_all_leaves_the_arm_out_while_a_grasp_is_selected(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page

    def of_this_table(route: Route) -> None:
        route.fulfill(json=json.loads(route.fetch().body()) | {"mode": "live"})

    def with_arm(route: Route) -> None:
        state = json.loads(route.fetch().body())
        route.fulfill(json=state | {"robot": state["robot"] | {"q_rad": [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]}})

    page.route(re.compile(r"/api/scans/[^/?]+$"), of_this_table)
    page.route("**/api/cell", with_arm)
    page.reload()
    page.keyboard.press("2")
    wait_until_drawn(page)
    fit, scale = page.get_by_role("button", name="All", exact=True), page.locator(".scale3d")
    page.get_by_role("button", name=re.compile("^0: .* apart")).click()
    fit.click()
    wait_until_unchanged(page)
    of_grasp = scale.inner_text()
    page.get_by_label("Arm", exact=True).check()
    fit.click()
    wait_until_unchanged(page)
    assert scale.inner_text() == of_grasp
    page.get_by_role("button", pressed=True).click()
    fit.click()
    expect(scale).not_to_have_text(of_grasp)


def with_reach(reach: Callable[[int], dict[str, Any] | None]) -> Callable[[Route], None]:
    """Return a handler that answers with the reach of each grasp, given its id."""

    def handle(route: Route) -> None:
        document = json.loads(route.fetch().body())
        for grasp in document["grasps"]:
            grasp["reach"] = reach(grasp["id"])
        route.fulfill(json=document)

    return handle


REACHED = {"reachable": True, "path_free": True, "reason": None, "message": None}
NOT_REACHED = {"reachable": False, "path_free": None, "reason": "out-of-reach", "message": "too far"}


def test_the_grasps_that_the_arm_reaches_are_listed_first(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    grasps = original_model(crossed)["grasps"]
    last = [grasp["id"] for grasp in grasps[-2:]]
    page.route(re.compile("/grasps([?]|$)"), with_reach(lambda one: REACHED if one in last else NOT_REACHED))
    page.keyboard.press("2")
    wait_until_drawn(page)
    expect(page.get_by_text(f"The arm reaches 2 of {len(grasps)} grasps. They are listed first.")).to_be_visible()
    entries = page.get_by_role("button", name=re.compile(r"fingers .* apart"))
    first = {grasp["cluster"]: grasp["id"] for grasp in reversed(grasps) if grasp["id"] in last}
    others = [grasp["id"] for grasp in listed(grasps, 10) if grasp["cluster"] not in first]
    expected = sorted(first.values()) + others
    expect(entries).to_have_text([re.compile(f"^{one}: ") for one in expected[:5]])
    not_reached = entries.filter(has_text="the arm does not reach it")
    expect(not_reached).to_have_count(5 - len(first))
    page.get_by_label("Grasps", exact=True).check()
    expect(page.locator(".label3d.grasp", has_text=re.compile(f"^grasp {expected[0]}$"))).to_have_count(1)


def test_the_page_says_that_the_arm_reaches_no_grasp(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed).page
    grasps = original_model(crossed)["grasps"]
    page.route(re.compile("/grasps([?]|$)"), with_reach(lambda _: NOT_REACHED))
    page.keyboard.press("2")
    expect(page.get_by_text(f"The arm reaches none of the {len(grasps)} grasps.")).to_be_visible()
    entries = page.get_by_role("button", name=re.compile(r"fingers .* apart"))
    expect(entries).to_have_text([re.compile(f"^{grasp['id']}: ") for grasp in listed(grasps)])


def test_the_reach_of_a_recording_is_checked_on_request(open_console: Open, crossed: ServedClient) -> None:
    """The string lies around the base of the arm, which cannot reach it."""
    page = open_console(crossed, "#/result").page
    scan = crossed.get("/api/scans").json()["scans"][-1]
    answer = crossed.get(scan["links"]["grasps"], params={"reach": True}).json()["grasps"]
    assert not any(grasp["reach"]["reachable"] for grasp in answer)
    page.get_by_role("button", name="Check the reach").click()
    expect(page.get_by_text(f"The arm reaches none of the {len(answer)} grasps.")).to_be_visible()
    expect(page.get_by_role("button", name="Check the reach")).to_have_count(0)
    page.get_by_role("button", name=re.compile("fingers .* apart")).first.click()
    expect(page.get_by_role("region", name="Selected grasp")).to_contain_text("the arm does not reach it: ")


def test_a_refused_check_of_the_reach_is_explained(open_console: Open, crossed: ServedClient) -> None:
    opened = open_console(crossed)
    page = opened.page
    opened.allow_errors("409")
    problem = {
        "type": "urn:pointchain:calibration",
        "title": "No calibration",
        "status": 409,
        "detail": "there is none",
    }
    page.route("**/grasps?reach=true", lambda route: route.fulfill(status=409, json=problem))
    page.keyboard.press("2")
    page.get_by_role("button", name="Check the reach").click()
    expect(page.get_by_role("alert").filter(has_text="There is none.")).to_be_visible()
    expect(page.get_by_role("button", name="Check the reach")).to_be_enabled()


def test_the_explanation_of_a_figure_has_the_width_of_the_list(open_console: Open, crossed: ServedClient) -> None:
    page = open_console(crossed, "#/result").page
    page.get_by_role("button", name=re.compile("fingers .* apart")).first.click()
    selected = page.get_by_role("region", name="Selected grasp")
    selected.get_by_role("button", name="What is: Standard deviation?").click()
    text, figures = selected.locator(".hint-text").bounding_box(), selected.locator("dl").bounding_box()
    assert text is not None
    assert figures is not None
    assert text["width"] > 0.95 * figures["width"]
