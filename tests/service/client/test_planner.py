"""A planner with a live cell: the program in the README, and a stop from another thread."""

import asyncio
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pointchain_client import AsyncClient, Client, Grasp, Model, ScanFailedError, ScanProgress
from tests.service.conftest import PATIENCE_S, Serve
from tests.service.live_cell import LiveCell, live_cell, release_used

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

ROOT = Path(__file__).resolve().parents[3]
PAGES = ("README.md", "service/client/README.md")
SHORT_GRIPPER = {"length_m": 0.07}
"""With this gripper, the camera meets the table at each grasp."""


@pytest.fixture(autouse=True)
def _arms_are_released(request: pytest.FixtureRequest) -> Iterator[None]:
    """The cells of this module run side by side until its end."""
    yield
    release_used(request)


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


@pytest.fixture(scope="module")
def short_gripper(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    with live_cell(serve, tmp_path_factory.mktemp("data"), gripper=SHORT_GRIPPER) as shared:
        yield shared


def run_first_program(page: str, cell: LiveCell) -> dict[str, object]:
    """Run the first Python program of a page with the service of `cell`, and return its variables."""
    program = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)[0]
    variables: dict[str, object] = {}
    exec(program.replace("http://127.0.0.1:8000", str(cell.client.base_url)), variables)
    return variables


@pytest.mark.parametrize("page", PAGES)
def test_the_first_program_prints_a_grasp_that_the_arm_reaches(
    page: str, cell: LiveCell, capsys: pytest.CaptureFixture[str]
) -> None:
    variables = run_first_program(page, cell)
    output = capsys.readouterr().out
    assert "ScanProgress(state='scanning'" in output
    model = variables["model"]
    assert isinstance(model, Model)
    if page == "README.md":
        assert "chain 0 over chain 0, gap 0.00" in output  # the only crossing of the default scene
    assert model.provenance is not None
    assert cell.state()["problem"] == "urn:pointchain:released"
    with Client(str(cell.client.base_url)) as planner:
        best = planner.grasps(model).reachable[0]
    assert isinstance(best, Grasp)
    assert best.reach is not None
    assert best.reach.path_free
    assert f"moveJ to {best.reach.q_pregrasp_rad} open to {best.opening_m} moveL" in output
    assert str(best.T_base_flange.grasp) in output


@pytest.mark.parametrize("page", PAGES)
def test_the_first_program_asks_a_person_where_the_arm_reaches_no_grasp(
    page: str, short_gripper: LiveCell, capsys: pytest.CaptureFixture[str]
) -> None:
    run_first_program(page, short_gripper)
    output = capsys.readouterr().out
    assert "ask a person\n  the camera comes too near the table" in output
    assert "moveJ" not in output
    assert short_gripper.state()["problem"] != "urn:pointchain:released"


def test_a_stop_from_another_thread_ends_the_wait(cell: LiveCell) -> None:
    with Client(str(cell.client.base_url)) as planner:
        moving = threading.Event()

        def on_progress(progress: ScanProgress) -> None:
            if "recorded" in progress.views.values():
                moving.set()

        def stop() -> None:
            assert moving.wait(PATIENCE_S)
            planner.stop()

        stopping = threading.Thread(target=stop)
        stopping.start()
        with pytest.raises(ScanFailedError, match="stopped by request") as failed:
            planner.scan(string_radius_m=0.0042, on_progress=on_progress, timeout_s=PATIENCE_S)
        stopping.join()
        assert failed.value.slug == "aborted"
        assert failed.value.scan.recording is not None
        assert planner.cell().state == "not_ready"


def test_a_stop_from_another_task_ends_the_wait(cell: LiveCell) -> None:
    async def plan() -> None:
        async with AsyncClient(str(cell.client.base_url)) as planner:
            moving = asyncio.Event()

            async def on_progress(progress: ScanProgress) -> None:
                if "recorded" in progress.views.values():
                    moving.set()

            async def stop() -> None:
                await moving.wait()
                await planner.stop()

            stopping = asyncio.create_task(stop())
            with pytest.raises(ScanFailedError, match="stopped by request") as failed:
                await planner.scan(string_radius_m=0.0042, on_progress=on_progress, timeout_s=PATIENCE_S)
            await stopping
            assert failed.value.slug == "aborted"
            assert (await planner.cell()).state == "not_ready"

    asyncio.run(plan())


def test_cancelling_a_task_ends_its_waiting_and_not_the_scan(cell: LiveCell) -> None:
    async def plan() -> None:
        async with AsyncClient(str(cell.client.base_url)) as planner:
            started = asyncio.Event()
            waiting = asyncio.create_task(
                planner.scan(string_radius_m=0.0042, on_progress=lambda _: started.set(), timeout_s=PATIENCE_S)
            )
            await started.wait()
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            newest = await anext(planner.scans())
            assert not newest.final
            assert (await planner.wait(newest, timeout_s=PATIENCE_S)).state == "succeeded"

    asyncio.run(plan())
