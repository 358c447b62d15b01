"""The page shows a protective stop, and a maintainer acknowledges it."""

import json
import re

import pytest
from playwright.sync_api import Locator, expect

from cell.control.status import FAULTS
from service.api.routes.console import BUILT
from tests.service.conftest import wait_until
from tests.service.console.conftest import Cell, Open

CHECK_FIRST = json.loads((BUILT.parent / "web/src/texts/en.json").read_text())["fault"]["check"]

# one at a time: each test runs several busy processes
pytestmark = [pytest.mark.xdist_group("console"), pytest.mark.without_3d]


def test_a_maintainer_acknowledges_a_protective_stop_after_checking(open_console: Open, cell: Cell) -> None:
    operator = open_console(cell.live.client, token=cell.tokens["operator"]).page
    opened = open_console(cell.live.client, token=cell.tokens["maintainer"])
    opened.allow_errors("409")  # too early
    maintainer = opened.page
    location = cell.live.start()
    cell.live.wait_for_motion(location)
    cell.live.controller.protective_stop()
    acknowledge = maintainer.get_by_role("button", name="Acknowledge: nothing moves")
    expect(acknowledge).to_be_disabled()
    maintainer.get_by_label("I have checked the cell").check()
    # The end of the scan may take longer than the five seconds after a stop in which the robot refuses the
    # acknowledgement. Another stop begins them again.
    wait_until(lambda: cell.live.client.get(location).json()["final"])
    cell.live.controller.reset()
    cell.live.controller.protective_stop()
    acknowledge.click()
    expect(maintainer.get_by_role("button", name="The robot needs a moment")).to_be_disabled()
    for page in (operator, maintainer):
        fault = page.get_by_role("region", name="Fault")
        expect(fault).to_contain_text("protective stop")
        for check in CHECK_FIRST["protective-stop"].values():
            expect(fault).to_contain_text(check)
        # The bar shows the last safety mode as long as it is recent. The service no longer listens to the robot.
        expect(page.get_by_role("banner")).to_contain_text(re.compile("safety: protective stop|last read"))
        page.keyboard.press("4")
        expect(fault).to_be_visible()  # on every screen
        page.keyboard.press("1")
    expect(operator.get_by_role("banner")).to_contain_text("last read")
    expect(operator.get_by_text("Ask a maintainer to check the cell")).to_be_visible()
    expect(operator.get_by_role("button", name="Acknowledge")).to_have_count(0)
    expect(operator.get_by_role("button", name="Scan: the arm will move")).to_be_disabled()

    scan = operator.get_by_role("button", name="Scan: the arm will move")
    before = scan.bounding_box()
    acknowledge_when_possible(acknowledge, maintainer.get_by_role("region", name="Fault"))
    for page in (operator, maintainer):
        expect(page.get_by_role("status").filter(has_text="an-maintainer acknowledged the fault at")).to_be_visible()
        expect(page.get_by_role("region", name="Fault")).to_have_count(0)
        expect(page.get_by_role("banner")).to_contain_text("Acknowledged: connect, or start a live scan")
    expect(scan).to_be_enabled()
    assert scan.bounding_box() == before, "the page moved under a person who did nothing"
    operator.get_by_role("button", name="Close").click()
    expect(operator.get_by_text("acknowledged the fault")).to_have_count(0)
    cell.make_ready()


def acknowledge_when_possible(button: Locator, fault: Locator) -> None:
    """Acknowledge as a person does: again when the robot has refused it as too early and the countdown is over.

    Only the robot knows when the second stop was; the service takes the wait from the first, or from its refusal.
    """
    for _ in range(3):
        button.click()
        expect(button).to_have_count(0)  # the fault has gone, or the button says to wait
        if fault.count() == 0:
            return


def test_each_fault_has_a_list_of_checks() -> None:
    assert set(CHECK_FIRST) == {fault.slug for fault in FAULTS}
