"""Calibrating by the page: watched, judged, taken into use, verified."""

from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.service.conftest import Serve
from tests.service.console.conftest import Open
from tests.service.live_cell import live_cell

pytestmark = pytest.mark.xdist_group("console")


def test_a_calibration_is_made_taken_into_use_and_verified(open_console: Open, serve: Serve, tmp_path: Path) -> None:
    with live_cell(serve, tmp_path, time_factor=20.0) as live:
        page = open_console(live.client, "#/calibration").page
        in_use = page.get_by_role("region", name="In use")
        expect(in_use).to_contain_text("not judged")
        page.get_by_text("Another board than the usual one").click()
        page.get_by_label("Poses").fill("12")
        page.get_by_role("button", name="Calibrate: the arm moves").click()

        run = page.get_by_role("region", name="Under way")
        expect(run.get_by_role("img", name="What the camera saw in view").first).to_be_visible()
        expect(run.get_by_role("img", name="The board was seen in")).to_be_visible()
        assert live.client.get("/api/calibration").json()["under_way"] is not None
        expect(run.get_by_role("list", name="Views")).to_contain_text(" px")

        last = page.get_by_role("region", name="The last run")
        expect(last).to_contain_text("It holds on views that it was not made from")
        (told,) = live.client.get("/api/calibration/runs").json()["runs"]
        seen = {cell for view in told["progress"]["views"] for cell in view["cells"]}
        expect(last.get_by_role("img", name=f"The board was seen in {len(seen)} of 40 parts")).to_be_visible()
        expect(last).to_contain_text(f"± {told['result']['metrics']['sigma_m'] * 1000:.2f} mm")
        assert live.client.get("/api/calibration").json()["calibration"]["verdict"] is None  # nothing is in use unasked

        last.get_by_role("button", name="Use this calibration").click()
        expect(last).to_contain_text("In use since")
        words = {"accept": "good", "warn": "usable, with warnings"}[told["result"]["verdict"]]
        expect(in_use).to_contain_text(words)
        expect(page.get_by_role("banner")).to_contain_text(words)

        page.get_by_role("button", name="Verify what is in use").click()
        expect(last.get_by_role("heading", name="Verification")).to_be_visible()
        expect(last).to_contain_text("It holds on views")
        page.get_by_role("region", name="Earlier").get_by_role("button").click()
        expect(page.get_by_role("region", name="Earlier")).to_contain_text("In use since")
