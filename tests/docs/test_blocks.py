"""Every command and program in the documents runs, either here or in the test that `ELSEWHERE` names.

A `text` block that directly follows one is its output: what is printed is compared with it. The blocks of a page run
in order, in one folder. A recording that an earlier page has simulated with the same arguments is copied. A service
with a simulated cell answers the requests of the blocks.
"""

import ast
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import AbstractContextManager, redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from cell.config.camera_config import SimulatedCamera
from cell.config.camera_names import CameraName
from service.config.loader import load_config
from tests.cell.loopback import free_host
from tests.docs import setting_up
from tests.docs.forked_command import TIMEOUT_S, run_forked
from tests.docs.outputs import LIVE, SEEDED, differences
from tests.docs.pages import ROOT, Block, blocks, commands, name_of, pages
from tests.service.conftest import Serve, wait_until
from tests.service.live_cell import LiveCell, live_cell

ADDRESS = "http://127.0.0.1:8000"
ELSEWHERE = {
    "make demo": "tests/service/cli/test_main.py::test_demo_compares_with_the_truth_and_can_be_repeated",
    "make test": ".ci/run::make test",
    "make serve": "tests/service/cli/commands/test_serve.py::test_text_log_has_plain_start_lines",
    "make setup": "Makefile::setup:",
    "pip install ./service/client": "tests/service/client/test_distribution.py"
    "::test_pip_install_gives_a_client_that_needs_nothing_else_of_the_project",
    "source .venv/bin/activate": ".ci/setup::venv",
    "pointchain scan table.mcap": "tests/service/cli/commands/test_scan.py::",
    "pointchain camera-profile": "tests/service/interchange/test_camera_profile.py"
    "::test_a_recording_becomes_a_camera_file",
    "pointchain simulate again.mcap": "tests/service/interchange/test_camera_profile.py::again.mcap",
    "pointchain check": "tests/service/cli/commands/test_check.py::test_check_prints_what_is_wrong_and_what_to_do",
    "pointchain calibrate run": "tests/service/cli/calibrate/test_run.py::test_a_new_cell_is_calibrated",
    "pointchain calibrate verify": "tests/service/cli/calibrate/test_run.py"
    "::test_a_new_cell_is_calibrated_activated_and_verified",
    "pointchain calibrate solve": "tests/service/cli/calibrate/test_solve.py::test_a_folder_can_be_solved_again",
    "pointchain calibrate activate": "tests/service/cli/calibrate/test_solve.py"
    "::test_activate_makes_a_result_the_active_calibration",
    "pointchain audit": "tests/service/security/audit/test_log.py::main([",
    "pointchain bench": "tests/service/benchmark/test_command.py::test_speed_is_printed_as_tables",
    "pointchain recognise recordings --cluster": "tests/service/batch/test_cluster.py::test_the_cluster_recognises",
    "pointchain token remove": "tests/service/security/auth/test_tokens.py::",
    "docker compose": "tests/docker/test_docker.py::test_the_compose_file_is_as_specified",
    "docker run --rm -v pointchain_cell": "docker/compose.yaml::name: pointchain",
    "sudo cp docker/80-oak.rules": "docker/80-oak.rules::sudo cp docker/80-oak.rules",
    "sudo chown 10001": "docker/Dockerfile::--uid 10001",
    "python -m cell.simulation.ur_controller": "tests/cell/simulation/ur_controller/test_launcher.py"
    "::test_a_started_controller_accepts_connections",
    ".venv/bin/python -c 'from cell.simulation": "tests/cell/simulation/ur_controller/test_faults.py::protective_stop",
    "pytest -m ursim": "pyproject.toml::ursim: any UR controller",
    "npx openapi-typescript": "tests/examples/test_planner_types.py::openapi-typescript/bin/cli.js",
    "curl -H": "tests/service/security/auth/test_bind_policy.py::",
}
"""The test that covers a command, by the beginning of the command.

These commands take too long here, or need something that a test machine lacks.
"""
NOT_COMPARED_HERE = {
    "README.md": "compared by tests/service/cli/test_main.py",
    "docs/integrator/calibration.md": "the result of another cell; the second is compared by "
    "tests/service/cli/calibrate/test_run.py",
    "docs/integrator/depth-camera.md": "the tables of two cells; the step has tests of its own",
    "docs/integrator/exposures.md": "a measurement that takes the time of a real camera",
    "docs/integrator/security.md": "the audit log of a cell with a history",
    "docs/operator/checks.md": "the data folder of a cell with a history",
    "docs/planner/events.md": "a part of a stream",
}
"""Why outputs on a page are not compared with what is printed here, by page."""
CAMERA: CameraName = "ideal"
"""Camera of the cell, which takes less computing than the default. `make demo` is tested with the default."""
CELL_COMMANDS = ("pointchain scan", "pointchain calibrate", "pointchain viewpoints", "curl")
"""Commands that use the cell. Their tests run one at a time with the other tests of the cell."""


def elsewhere(command: str) -> str | None:
    """Return the test that runs a command in place of this one."""
    return next((test for begin, test in ELSEWHERE.items() if command.startswith(begin)), None)


def to_run(page: Path) -> list[Block]:
    """Return the blocks of a page that are run here."""
    return [
        block
        for block in blocks(page)
        if block.language == "python"
        or (block.language == "sh" and any(elsewhere(command) is None for command in commands(block)))
    ]


def shown_outputs(page: Path) -> dict[Block, Block]:
    """Return the output that a page shows after a block, by the block."""
    return {
        block: after
        for block, after in pairwise(blocks(page))
        if block.language in ("sh", "python") and after.language == "text" and name_of(page) not in NOT_COMPARED_HERE
    }


def uses_service(page: Path) -> bool:
    """Return whether a page's blocks call the service."""
    return any(ADDRESS in block.text for block in to_run(page))


def uses_cell(page: Path) -> bool:
    """Return whether a page's blocks need the cell or the service."""
    return uses_service(page) or any(begin in block.text for block in to_run(page) for begin in CELL_COMMANDS)


# The pages that call the service come last: its cell takes a quarter of a core as long as it is connected.
PAGES = [
    pytest.param(page, id=name_of(page), marks=[pytest.mark.xdist_group("documents")] if uses_cell(page) else [])
    for page in sorted(pages(), key=lambda page: (uses_service(page), uses_cell(page)))
    if to_run(page)
]


class Runner:
    """Runs the blocks of one page."""

    def __init__(self, folder: Path, cell: LiveCell | None) -> None:
        self._folder = folder
        self._address = None if cell is None else str(cell.client.base_url).rstrip("/")
        self._ids: dict[str, str] = {}
        self._names: dict[str, Any] = {"__name__": "__main__"}
        self._environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "XDG_CACHE_HOME": str(folder / "cache"),
            "POINTCHAIN_DATA_DIR": str(folder / "data"),
            "POINTCHAIN_ARM__HOST": free_host(),
            "POINTCHAIN_ARM__TIME_FACTOR": "20",
            "POINTCHAIN_ARM__WATCHDOG_HZ": "1",
            "POINTCHAIN_CAMERA__MODEL": CAMERA,
            "POINTCHAIN_CAMERA__FPS": "30",
            "POINTCHAIN_CAMERA__EXPOSURES": "1",
        }

    def run(self, block: Block) -> str:
        """Run a block, each command of a `sh` block or a whole `python` block, and return what it prints."""
        where = f"{block.page}:{block.line}"
        if block.language == "python":
            with redirect_stdout(io.StringIO()) as printed:
                exec(compile(self._addressed(block.text), where, "exec"), self._names)
            return printed.getvalue()
        here = (command for command in commands(block) if elsewhere(command) is None)
        return "".join(self._run_command(command, where) for command in here)

    def _addressed(self, text: str) -> str:
        return text if self._address is None else text.replace(ADDRESS, self._address)

    def _run_command(self, command: str, where: str) -> str:
        setting_up.prepare_command(command, self._folder)
        if setting_up.copy_simulated(command, self._folder):
            return ""
        line = self._addressed(command)
        if command.startswith("curl"):
            for name, value in self._ids.items():
                line = re.sub(rf"\b{name}\b", value, line)
            # Without --fail, curl exits with 0 after an error response.
            line = line.replace("curl ", "curl --silent --show-error --fail --max-time 100 ", 1)
        # the README shows that the installed command starts from a shell
        forked = None if where.startswith("README.md:") else run_forked(line, self._folder, self._environment)
        code, output = forked or self._run_in_shell(line)
        # `compare` exits with 1 if something changed
        accepted = (0, 1) if command.startswith("pointchain compare") else (0,)
        assert code in accepted, f"{where}: {command}\n{output[-3000:]}"
        setting_up.keep_simulated(command, self._folder)
        made = re.search(r'"id": ?"([\w-]+)"', output)
        if command.startswith("curl") and made is not None and "/api/scans/" not in command:
            kind = next((word for word in ("recordings", "runs") if word in command), "scans")
            self._ids[{"recordings": "REC", "runs": "RUN", "scans": "SCAN"}[kind]] = made[1]
        return output

    def _run_in_shell(self, line: str) -> tuple[int, str]:
        done = subprocess.run(
            ["bash", "-euc", line],
            cwd=self._folder,
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=TIMEOUT_S,
        )
        return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def shared_cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A live cell that all pages share, like a service that has been running for a while."""
    with default_cell(serve, tmp_path_factory.mktemp("data")) as live:
        yield live


@pytest.fixture
def new_cell(serve: Serve, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCell]:
    """A live cell that has not scanned yet."""
    with default_cell(serve, tmp_path_factory.mktemp("data")) as live:
        yield live


def default_cell(serve: Serve, data: Path) -> AbstractContextManager[LiveCell]:
    """Return a fast live cell with the scene and the errors of the default configuration, as readers have it."""
    camera = SimulatedCamera(model=CAMERA)
    return live_cell(serve, data, scene=camera.scene, seed=camera.seed, model=camera.model)


@pytest.fixture
def cell(request: pytest.FixtureRequest) -> LiveCell | None:
    """The live cell if the page calls the service. Recognition is loaded and no job is active."""
    page: Path = request.getfixturevalue("page")
    if not uses_service(page):
        return None
    # the number of an event in a page is one of the first scan
    is_first = any("Last-Event-ID" in block.text for block in to_run(page))
    live: LiveCell = request.getfixturevalue("new_cell" if is_first else "shared_cell")
    live.is_well()
    wait_until(lambda: live.client.get("/readyz").status_code == 200)
    return live


@pytest.mark.timeout(600)
@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_and_programs_of_a_page_run(
    fork_server: None, page: Path, cell: LiveCell | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    setting_up.prepare_page(name_of(page), tmp_path)
    runner = Runner(tmp_path, cell)
    shown = shown_outputs(page)
    tolerance = LIVE if uses_cell(page) else SEEDED
    for block in to_run(page):
        printed = runner.run(block)
        output = shown.get(block)
        if output is not None:
            wrong = differences(output.text, printed, tolerance)
            assert wrong == [], f"{output.page}:{output.line}\n" + "\n".join(wrong)


def test_each_output_that_is_shown_is_compared() -> None:
    for page in pages():
        not_run = [block for block in shown_outputs(page) if block not in to_run(page)]
        assert not_run == [], "compare this output where the command is tested"
        shows = any(after.language == "text" for block, after in pairwise(blocks(page)) if block.language != "text")
        assert shows or name_of(page) not in NOT_COMPARED_HERE


ALL = [block for page in pages() for block in blocks(page)]
SHOWN = sorted({command for block in ALL if block.language == "sh" for command in commands(block)})


@pytest.mark.parametrize("command", [command for command in SHOWN if elsewhere(command) is not None])
def test_a_command_not_run_here_has_another_test(command: str) -> None:
    covering_test = elsewhere(command)
    assert covering_test is not None
    file, _, name = covering_test.partition("::")
    assert name in (ROOT / file).read_text()


def test_every_rule_matches_a_command() -> None:
    """An unused rule would exempt a later command with the same beginning."""
    assert [begin for begin in ELSEWHERE if not any(command.startswith(begin) for command in SHOWN)] == []


def test_each_block_has_a_known_language() -> None:
    known = {"sh", "python", "toml", "json", "text", "typescript", "mermaid", "bibtex", "yaml"}
    wrong = [f"{b.page}:{b.line}: {b.language!r}" for b in ALL if b.language not in known and b.language[:1] != "{"]
    assert wrong == []


@pytest.mark.parametrize("block", [b for b in ALL if b.language == "json"], ids=lambda b: f"{b.page}:{b.line}")
def test_json_is_valid(block: Block) -> None:
    json.loads(block.text)


@pytest.mark.parametrize("block", [b for b in ALL if b.language == "toml"], ids=lambda b: f"{b.page}:{b.line}")
def test_configurations_are_accepted(block: Block, tmp_path: Path) -> None:
    tomllib.loads(block.text)
    file = tmp_path / "cell.toml"
    file.write_text(block.text)
    load_config(file)
    # Settings in comments are accepted too.
    file.write_text(re.sub(r"^# (?=\w+ = )", "", block.text, flags=re.MULTILINE))
    load_config(file)


@pytest.mark.parametrize("block", [b for b in ALL if b.language == "python"], ids=lambda b: f"{b.page}:{b.line}")
def test_programs_are_complete(block: Block) -> None:
    tree = ast.parse(block.text)
    dots = [node for node in tree.body if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]
    assert not [node for node in dots if isinstance(node.value, ast.Constant) and node.value.value is Ellipsis]
