"""The service stops answering and comes back."""

import os
import signal
from pathlib import Path

import pytest
from playwright.sync_api import expect

from tests.service.console.boxes import assert_texts_fit
from tests.service.console.conftest import Open
from tests.service.service_process import process

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]


def test_the_page_marks_its_state_as_old_until_the_service_is_back(open_console: Open, tmp_path: Path) -> None:
    with process(tmp_path / "data", tmp_path / "log") as (running, client):
        port = str(client.base_url.port)
        opened = open_console(client)
        page = opened.page
        bar = page.get_by_role("banner")
        expect(bar).to_contain_text("Not connected yet")
        scan = page.get_by_role("button", name="Scan: the arm will move")
        expect(scan).to_be_enabled()
        opened.check()  # no error is allowed up to here

        # From here on, connections break in many ways, and the browser names each one. A refusal by the service has
        # another text and still fails the test.
        opened.allow_errors("net::ERR_")
        os.kill(running.pid, signal.SIGSTOP)  # the service hangs: connections stay open, no data arrives
        expect(bar).to_contain_text("State unknown: no connection")
        expect(bar).to_contain_text("The page shows the state at that time")
        for width, height in ((390, 844), (1024, 768), (1280, 800)):
            page.set_viewport_size({"width": width, "height": height})
            assert_texts_fit(page)
        expect(scan).to_be_disabled()
        stop = page.get_by_role("button", name="STOP the arm")
        expect(stop).to_be_enabled()
        stop.click()
        expect(page.locator("#stop-message")).to_contain_text("STOP HAS NOT GOT THROUGH YET")
        os.kill(running.pid, signal.SIGCONT)
        # The page repeats the request of the same press until it gets through.
        expect(page.locator("#stop-message")).to_contain_text("No arm is connected")
        expect(bar).to_contain_text("Not connected yet")
        expect(bar.get_by_text("Live", exact=True)).to_be_visible()
        expect(scan).to_be_enabled()
        stop.click()
        expect(page.locator("#stop-message")).to_contain_text("No arm is connected")
    expect(bar).to_contain_text("State unknown: no connection")
    with process(tmp_path / "data", tmp_path / "log2", POINTCHAIN_PORT=port):
        expect(bar).to_contain_text("Not connected yet")
        expect(bar.get_by_text("Live", exact=True)).to_be_visible()
        expect(scan).to_be_enabled()
