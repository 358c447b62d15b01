"""A planner with a live cell: the program in the README, and a stop from another thread."""

import asyncio
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from pointchain_client import AsyncClient, Client, Model, ScanFailedError, ScanProgress
from tests.service.conftest import PATIENCE_S, Serve
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("service")  # one at a time, because each test runs several busy processes

README = (Path(__file__).resolve().parents[3] / "README.md").read_text()


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


def test_the_planner_of_the_readme_runs(cell: LiveCell, capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    namespace: dict[str, object] = {}
    exec(program.replace("http://127.0.0.1:8000", str(cell.client.base_url)), namespace)
    output = capsys.readouterr().out
    assert "ScanProgress(state='scanning'" in output
    assert "chain 0 over chain 0, gap 0.00" in output  # the only crossing of the default scene
    model = namespace["model"]
    assert isinstance(model, Model)
    assert model.grasps[0].T_base_grasp.shape == (4, 4)
    assert str(model.grasps[0].T_base_grasp) in output
    assert cell.state()["problem"] == "urn:pointchain:released"


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
