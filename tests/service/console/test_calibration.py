"""A person calibrates on the page: watches the run, reads the verdict, activates and verifies."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import expect

from calibration.target.board import Board, board_with_defaults
from service.jobs.submission import new_calibration
from tests.service.api.routes.test_calibration import REFUSED
from tests.service.conftest import Serve, ServedClient
from tests.service.console.conftest import Open
from tests.service.live_cell import LiveCell, live_cell
from tests.service.security.conftest import without_recognition

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]

EXCLUDED_VIEW = {
    **dict.fromkeys(("rms_px", "robot_error_m", "robot_error_rad", "loo_error_m", "distance_m")),
    "name": "04_pose11",
    "used": False,
    "reason": "it contradicts the others",
    "corners": 48,
}
"""A view that the solver excluded."""


@pytest.fixture(scope="module")
def live(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A fast simulated cell whose calibration has no verdict."""
    with live_cell(serve, tmp_path_factory.mktemp("data"), time_factor=20.0) as cell:
        yield cell


@pytest.fixture(scope="module")
def rejected(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServedClient]:
    """A service whose only calibration was rejected."""
    result = REFUSED | {"views": [EXCLUDED_VIEW]}
    run = replace(new_calibration("calibration", Board(), 12), state="succeeded", result=result)
    with without_recognition(serve, tmp_path_factory.mktemp("data")) as client:
        store = client.app.state.context.store.calibrations
        store.add(run)
        store.set_view(run.id, 11, "recorded")
        yield client


def test_a_calibration_is_made_activated_and_verified(open_console: Open, live: LiveCell) -> None:
    page = open_console(live.client, "#/calibration").page
    in_use = page.get_by_role("region", name="Active calibration")
    expect(in_use).to_contain_text("not judged")
    board = board_with_defaults({})
    page.get_by_text("Another board, or another number of poses").click()
    pitch = f"{board.pitch_m * 1000:g}"
    for label, number in (("Columns", str(board.columns)), ("Rows", str(board.rows)), ("Side of a square", pitch)):
        expect(page.get_by_label(label)).to_have_attribute("placeholder", number)
    assert board.kind == "charuco"
    expect(page.get_by_role("main")).to_contain_text(f"ChArUco, {board.columns} x {board.rows} of {pitch} mm")
    page.get_by_label("Poses").fill("12")
    page.get_by_role("button", name="Calibrate: the arm moves").click()

    run = page.get_by_role("region", name="In progress")
    expect(run.get_by_role("img", name="Camera image of view").first).to_be_visible()
    expect(run.get_by_role("img", name="The board was seen in")).to_be_visible()
    assert live.client.get("/api/calibration").json()["active_run"] is not None
    page.keyboard.press("1")
    expect(page.get_by_text("A calibration or verification is running")).to_be_visible()
    expect(page.get_by_role("button", name="Scan: the arm will move")).to_be_disabled()
    page.keyboard.press("4")
    expect(run.get_by_role("list", name="Views")).to_contain_text(" px")

    last = page.get_by_role("region", name="The last run")
    expect(last).to_contain_text("The calibration holds on views that were not used to make it")
    (document,) = live.client.get("/api/calibration/runs").json()["runs"]
    seen = {cell for view in document["progress"]["views"] for cell in view["cells"]}
    expect(last.get_by_role("img", name=f"The board was seen in {len(seen)} of 40 parts")).to_be_visible()
    expect(last).to_contain_text(f"± {document['result']['metrics']['sigma_m'] * 1000:.2f} mm")
    expect(last).to_contain_text(f"{document['result']['board']['scale'] * 100:.2f} %")
    found = [view for view in document["progress"]["views"] if view["corners"] is not None]
    expect(last).to_contain_text(f"The board was found in {len(found)} of 14 views")
    # A result is never activated automatically.
    assert live.client.get("/api/calibration").json()["calibration"]["verdict"] is None

    last.get_by_role("button", name="Use this calibration").click()
    expect(last).to_contain_text("Active since")
    verdict = {"accept": "good", "warn": "usable, with warnings"}[document["result"]["verdict"]]
    expect(in_use).to_contain_text(verdict)
    expect(page.get_by_role("banner")).to_contain_text(verdict)

    page.get_by_role("button", name="Verify the active calibration").click()
    expect(last.get_by_role("heading", name="Verification")).to_be_visible()
    expect(last).to_contain_text("The calibration holds on views")
    page.get_by_role("region", name="Earlier runs").get_by_role("button").click()
    expect(page.get_by_role("region", name="Earlier runs")).to_contain_text("Active since")


def test_a_rejected_run_is_shown_as_rejected_everywhere(open_console: Open, rejected: ServedClient) -> None:
    opened = open_console(rejected, "#/calibration")
    opened.allow_errors("404.*views/11.png")  # this picture does not exist
    page = opened.page
    last = page.get_by_role("region", name="The last run")
    expect(last).to_contain_text("must not be used")
    expect(last).to_contain_text("All turns are about one axis: tilt it too.")
    expect(last).to_contain_text("View 11 was excluded: it contradicts the others.")  # the number of its picture
    expect(last.get_by_role("list", name="Views")).to_contain_text("11: searching for the board")
    expect(last.get_by_role("button", name="Use this calibration")).to_have_count(0)

    store = rejected.app.state.context.store.calibrations
    store.add(replace(new_calibration("verification", None, 2), state="aborted"))
    page.reload()
    expect(last.get_by_role("heading", name="Verification")).to_contain_text("Stopped")
    earlier = page.get_by_role("region", name="Earlier runs").get_by_role("button")
    expect(earlier).to_contain_text("must not be used")
    expect(earlier.locator(".badge.bad")).to_be_visible()
    earlier.click()
    expect(page.get_by_role("region", name="Calibration, ")).to_contain_text("must not be used")
    expect(page.get_by_role("region", name="The last run")).to_have_count(1)
