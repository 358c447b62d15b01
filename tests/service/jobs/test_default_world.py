"""A live scan over HTTP of the simulated cell with its default camera, which matches depth in rendered images."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from cell.config.camera_config import SimulatedCamera
from cell.config.camera_names import DEFAULT_CAMERA
from cell.recording import read_recording
from cell.simulation.devices.world import simulated_world, world_truth
from cell.simulation.evaluation.metrics import score
from tests.service.conftest import Serve
from tests.service.live_cell import live_cell


@pytest.mark.slow
def test_the_default_cell_recognises_its_string(
    serve: Serve, tmp_path: Path, finished: Callable[[httpx2.Client, str], dict[str, Any]]
) -> None:
    default = SimulatedCamera()
    with live_cell(serve, tmp_path, scene=default.scene, seed=default.seed, model=default.model) as cell:
        location = cell.start(string_radius_m=default.string_radius_m)
        scan = finished(cell.client, location)
        assert scan["state"] == "succeeded", scan
        model = cell.client.get(f"{location}/model").json()
        content = cell.client.get(scan["links"]["recording"])
        truth = world_truth(simulated_world(cell.settings))
    judged = score(model, truth)
    assert judged.topology
    assert judged.mean_m is not None
    assert judged.mean_m < 0.001
    codes = {finding["code"] for finding in model["quality"]["findings"]}
    assert not codes & {"table-elsewhere", "calibration-drift", "view-excluded"}
    assert content.status_code == 200
    path = tmp_path / "scan.mcap"
    path.write_bytes(content.content)
    provenance = read_recording(path).header.provenance
    assert DEFAULT_CAMERA in provenance["camera"]
    assert provenance["sheath"]
