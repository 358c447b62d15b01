"""The service called in every way that its description allows, and in many that it does not, by schemathesis.

With all its checks: no 5xx but those described, and only answers as described, in type, headers and content; what is as
described is taken, what is not is refused, as are other methods and whoever has no token.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from cell.config.arm_config import SimulatedArm, URArm
from cell.config.camera_config import OakCamera, SimulatedCamera
from service.security.auth.tokens import add_token
from tests.cell.loopback import free_host
from tests.service.conftest import Serve
from tests.service.live_cell import FAST
from tests.service.service_process import ROOT

RUN = [sys.executable, "-c", "from schemathesis.cli import schemathesis; schemathesis()"]
CONFIG = Path(__file__).with_name("fuzz.toml")
EXAMPLES = 1000
"""Of each operation, before a release; more where there are more odd cases to try."""
ALL_PHASES, LINKS = "examples,coverage,fuzzing,stateful", "stateful"
SCENARIOS = re.compile(r"Scenarios: +(\d+)")
"""How many times links were followed."""


def test_the_service_is_as_described(
    serve: Serve, recording_file: Path, finished: Callable[..., Any], tmp_path: Path
) -> None:
    # Recordings only: no robot answers, and nothing is planned, which takes long, for there is no calibration.
    settings = {"arm": URArm(kind="ur", host=free_host()), "camera": OakCamera(kind="oak")}
    fuzz(serve, recording_file, finished, tmp_path, settings, 10, seed=1)


@pytest.mark.fuzz
@pytest.mark.timeout(4 * 3600)
@pytest.mark.xdist_group("cell")
def test_the_service_and_its_cell_are_as_described(
    serve: Serve, recording_file: Path, finished: Callable[..., Any], tmp_path: Path
) -> None:
    examples = int(os.environ.get("FUZZ_EXAMPLES", str(EXAMPLES)))
    settings = {
        "arm": SimulatedArm(host=free_host(), time_factor=100.0, watchdog_hz=1.0),
        "camera": SimulatedCamera(model="ideal", **FAST),
    }
    fuzz(serve, recording_file, finished, tmp_path, settings, examples)


def fuzz(
    serve: Serve,
    recording_file: Path,
    finished: Callable[..., Any],
    tmp_path: Path,
    settings: dict[str, Any],
    examples: int,
    seed: int | None = None,
) -> None:
    """Lets schemathesis at a service with a recording and a scan that has a result; its report where it finds fault."""
    data = tmp_path / "data"
    headers = {"Authorization": f"Bearer {add_token(data, 'fuzz', 'maintainer')}"}
    with serve(data, **settings) as client:
        client.headers.update(headers)
        give_it_a_result(client, recording_file, finished)
        command = [
            *[*RUN, f"--config-file={CONFIG}", "run", f"{client.base_url}/openapi.json", "--no-color", "--checks=all"],
            *[f"--header=Authorization: {headers['Authorization']}", f"--max-examples={examples}"],
        ]
        well, scenarios = run(command, recording_file, ALL_PHASES, seed)
        # It gives links up, quietly, at the first scenario that goes otherwise when it is done again, as that of a
        # recording that the first time has removed does.
        while scenarios < examples:
            seed = None if seed is None else seed + 1
            well_again, more = run(command, recording_file, LINKS, seed)
            assert more, "no links are followed"
            well, scenarios = well and well_again, scenarios + more
        assert well, "schemathesis found fault; its report has each with a call that shows it"
        # Whatever was asked of it: it stops, and lives.
        assert client.post("/api/cell/stop").status_code == 200


def run(command: list[str], recording_file: Path, phases: str, seed: int | None) -> tuple[bool, int]:
    """One run, whose report is printed: whether it found nothing, and in how many scenarios it followed links."""
    told = [f"--phases={phases}"] if seed is None else [f"--phases={phases}", f"--seed={seed}"]
    hooks = {"SCHEMATHESIS_HOOKS": "tests.service.fuzz.fuzz_hooks", "FUZZ_RECORDING": str(recording_file)}
    ended = subprocess.run(
        [*command, *told], cwd=ROOT, env=os.environ | hooks, capture_output=True, text=True, check=False
    )
    print(ended.stdout, ended.stderr)
    found = SCENARIOS.search(ended.stdout)
    return ended.returncode == 0, 0 if found is None else int(found[1])


def give_it_a_result(client: httpx2.Client, recording_file: Path, finished: Callable[..., Any]) -> None:
    """The service has a scan of a recording, with a model."""
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    assert finished(client, answer.headers["Location"])["state"] == "succeeded"
