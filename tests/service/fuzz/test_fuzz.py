"""Schemathesis calls every operation of the service with valid and invalid requests.

All its checks are on. Answers match the description in status, type, headers and content. Valid requests are accepted.
Invalid requests, other methods and requests without a token are refused.
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
"""Examples of each operation before a release; operations with more edge cases get more."""
ALL_PHASES, LINKS = "examples,coverage,fuzzing,stateful", "stateful"
SCENARIOS = re.compile(r"Scenarios: +(\d+)")
"""Finds the number of scenarios in which links were followed."""


def test_the_service_matches_its_description(
    serve: Serve, recording_file: Path, finished: Callable[..., Any], tmp_path: Path
) -> None:
    # Only recordings can be scanned: no robot answers. Without a calibration, the slow planning does not run.
    settings = {"arm": URArm(kind="ur", host=free_host()), "camera": OakCamera(kind="oak")}
    fuzz(serve, recording_file, finished, tmp_path, settings, 10, seed=1)


@pytest.mark.fuzz
@pytest.mark.timeout(4 * 3600)
@pytest.mark.xdist_group("service")
def test_the_service_with_a_cell_matches_its_description(
    serve: Serve, recording_file: Path, finished: Callable[..., Any], tmp_path: Path
) -> None:
    examples = int(os.environ.get("FUZZ_EXAMPLES", str(EXAMPLES)))
    settings = {
        "arm": SimulatedArm(host=free_host(), time_factor=100.0, watchdog_hz=1.0),
        "camera": SimulatedCamera(model="exact", **FAST),
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
    """Run schemathesis against a service with a recording and a scan result, and assert that it finds nothing."""
    data = tmp_path / "data"
    headers = {"Authorization": f"Bearer {add_token(data, 'fuzz', 'maintainer')}"}
    with serve(data, **settings) as client:
        client.headers.update(headers)
        add_result(client, recording_file, finished)
        command = [
            *[*RUN, f"--config-file={CONFIG}", "run", f"{client.base_url}/openapi.json", "--no-color", "--checks=all"],
            *[f"--header=Authorization: {headers['Authorization']}", f"--max-examples={examples}"],
        ]
        passed, scenarios = run(command, recording_file, ALL_PHASES, seed)
        # Schemathesis silently stops following links at the first scenario that cannot be repeated, for example because
        # the first time removed the recording.
        while scenarios < examples:
            seed = None if seed is None else seed + 1
            passed_again, more = run(command, recording_file, LINKS, seed)
            assert more, "no link was followed"
            passed, scenarios = passed and passed_again, scenarios + more
        assert passed, "schemathesis found failures; its report shows a call for each"
        # The service still runs and carries out a stop.
        assert client.post("/api/cell/stop").status_code == 200


def run(command: list[str], recording_file: Path, phases: str, seed: int | None) -> tuple[bool, int]:
    """Run schemathesis once and print its report.

    Returns:
        Whether it found nothing, and in how many scenarios it followed links.
    """
    options = [f"--phases={phases}"] if seed is None else [f"--phases={phases}", f"--seed={seed}"]
    hooks = {"SCHEMATHESIS_HOOKS": "tests.service.fuzz.fuzz_hooks", "FUZZ_RECORDING": str(recording_file)}
    done = subprocess.run(
        [*command, *options], cwd=ROOT, env=os.environ | hooks, capture_output=True, text=True, check=False
    )
    print(done.stdout, done.stderr)
    found = SCENARIOS.search(done.stdout)
    return done.returncode == 0, 0 if found is None else int(found[1])


def add_result(client: httpx2.Client, recording_file: Path, finished: Callable[..., Any]) -> None:
    """Add a recording and a scan of it that has a model."""
    recording = client.post("/api/recordings", content=recording_file.read_bytes()).json()["id"]
    answer = client.post("/api/scans", json={"mode": "replay", "recording": recording})
    assert finished(client, answer.headers["Location"])["state"] == "succeeded"
