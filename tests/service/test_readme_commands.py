"""Every command that the README shows is run: here, as it stands there, or by the test that is named."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.recording import read_recording
from tests.cell.bag.bags import Recorded, one_image_each, write_bag
from tests.cell.loopback import free_host
from tests.service.conftest import Serve
from tests.service.live_cell import LiveCell, live_cell

pytestmark = pytest.mark.xdist_group("cell")  # one at a time: several busy processes

ROOT = Path(__file__).resolve().parents[2]
BLOCKS = re.findall(r"^```sh\n(.*?)^```", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
COMMANDS = list(dict.fromkeys(re.sub(r"\s+# .*", "", line) for block in BLOCKS for line in block.splitlines() if line))
"""In their order; one that is shown again counts once."""
ELSEWHERE = {
    "make demo": "tests/service/test_cli.py::test_demo_tells_the_truth_and_can_be_repeated",
    "make test": ".ci/run::make --keep-going lint test",
    "pointchain check": "tests/service/test_check.py::test_an_operator_reads_what_is_wrong_and_what_to_do",
    "pointchain calibrate run": "tests/service/calibrate/test_run.py::test_from_nothing_to_a_calibration_in_use",
    "pointchain serve": "tests/service/test_serve.py::test_at_a_terminal_they_are_lines",
    "pointchain audit": "tests/service/security/test_audit.py::main([",
    "pointchain bench": "tests/service/test_bench.py::test_people_get_tables",
    "pointchain recognise archive --cluster": "tests/service/archive/test_cluster.py::test_it_recognises_there",
    "pointchain token remove": "tests/service/security/test_tokens.py::",
    "docker compose": "tests/docker/test_docker.py::test_the_compose_file_is_as_specified",
    "curl -H": "tests/service/security/test_binding.py::",
}
"""By how a command begins: what takes too long here, or needs what a test machine has not."""


def elsewhere(command: str) -> str | None:
    return next((test for begin, test in ELSEWHERE.items() if command.startswith(begin)), None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where they are run one after the other, with what they take for granted."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "cell.toml").write_text("[gripper]\nstroke_m = 0.085\n")
    (folder / "archive").mkdir()
    return folder


@pytest.fixture(scope="module")
def environment(folder: Path) -> dict[str, str]:
    """Of a cell that is as quick as may be."""
    return os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "POINTCHAIN_DATA_DIR": str(folder / "data"),
        "POINTCHAIN_ARM__HOST": free_host(),
        "POINTCHAIN_ARM__TIME_FACTOR": "20",
        "POINTCHAIN_ARM__WATCHDOG_HZ": "1",
    }


@pytest.fixture(scope="module")
def cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    with live_cell(serve, tmp_path_factory.mktemp("data")) as shared:
        yield shared


def prepare(command: str, folder: Path) -> None:
    """What a command needs beside what those before it have made."""
    if "session.bag" in command:
        views = read_recording(folder / "knot.mcap").views
        write_bag(folder / "session.bag", "ros1", one_image_each(views, Recorded(encoding="32FC1")))
    if "recognise archive" in command:
        shutil.copy(folder / "knot.mcap", folder / "archive")
    if "compare" in command:
        shutil.copy(folder / "new.jsonl", folder / "old.jsonl")


@pytest.mark.parametrize("command", [c for c in COMMANDS if c.startswith("pointchain") and elsewhere(c) is None])
def test_it_does_what_it_is_shown_to(command: str, folder: Path, environment: dict[str, str]) -> None:
    prepare(command, folder)
    done = subprocess.run(
        ["bash", "-euc", command], cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
def test_the_service_answers_as_it_is_shown_to(cell: LiveCell, recording_file: Path, tmp_path: Path) -> None:
    shutil.copy(recording_file, tmp_path / "knot.mcap")
    ids: dict[str, str] = {}
    for command in (c for c in COMMANDS if c.startswith("curl") and elsewhere(c) is None):
        asked = command.replace("http://127.0.0.1:8000", str(cell.client.base_url).rstrip("/"))
        for name, value in ids.items():
            asked = asked.replace(name, value)
        # What is shown without -f would be shown a refusal as well.
        asked = asked.replace("curl ", "curl --silent --show-error --fail ", 1)
        done = subprocess.run(
            ["bash", "-euc", asked], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
        )
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        made = re.search(r'"id": ?"([\w-]+)"', done.stdout)
        if made is not None and "/api/scans/" not in command:
            ids["REC" if "recordings" in command else "SCAN"] = made[1]
    assert set(ids) == {"SCAN", "REC"}
    assert (tmp_path / "preview.png").stat().st_size > 1000


@pytest.mark.parametrize("command", [command for command in COMMANDS if elsewhere(command) is not None])
def test_what_is_not_run_here_is_run_there(command: str) -> None:
    place = elsewhere(command)
    assert place is not None
    file, _, what = place.partition("::")
    assert what in (ROOT / file).read_text()


def test_nothing_is_left_out() -> None:
    assert [c for c in COMMANDS if elsewhere(c) is None and not c.startswith(("pointchain", "curl"))] == []
