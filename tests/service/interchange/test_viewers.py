"""Rerun opens the files of Pointchain. The tests need the program `rerun` of `rerun-sdk` on the PATH."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from cell.recording import RecordingWriter
from cell.recording.result_file import write_result_file
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.request import RecognitionRequest
from service.processing.results import recognise_views

RERUN = shutil.which("rerun")
pytestmark = pytest.mark.skipif(RERUN is None, reason="rerun is not installed")


def rerun(*arguments: object) -> str:
    """Run Rerun without its analytics and return its output."""
    assert RERUN is not None
    done = subprocess.run(
        [RERUN, *map(str, arguments)],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "RERUN_ANALYTICS": "off"},
    )
    return done.stdout + done.stderr


def columns_of(path: Path) -> str:
    """Return the columns that Rerun makes of an MCAP file."""
    output = rerun("mcap", "check", "--full", path)
    assert "error" not in output.lower()
    converted = path.with_suffix(".rrd")
    rerun("mcap", "convert", path, "-o", converted)
    rerun("rrd", "verify", converted)
    return rerun("rrd", "print", "-v", converted)


def test_rerun_opens_recordings_and_results(tmp_path: Path) -> None:
    scan = simulate(make_scene("loop", 1), camera_model("exact", (320, 200)), 1, views=3)
    model = recognise_views(
        scan.views, scan.header, (), RecognitionRequest(radius_m=scan.header.string_radius_m)
    ).model.to_json()
    with RecordingWriter(tmp_path / "scan.mcap", scan.header) as writer:
        for view in scan.views:
            writer.write_view(view)
        writer.write_result(model)
    write_result_file(tmp_path / "result.mcap", json.loads(json.dumps(model)))
    columns = columns_of(tmp_path / "scan.mcap")
    assert columns.count("/tf@Transform3D:translation") == 3
    assert columns.count("/camera/calibration@Pinhole:image_from_camera") == 3
    assert columns.count("/camera/depth@Image:buffer") == 3
    for converted in (columns, columns_of(tmp_path / "result.mcap")):
        # Rerun 0.41 reads scenes but does not draw them
        assert converted.count("/result/scene@foxglove.SceneUpdate:message") == 1
        assert converted.count("/result/model@McapMessage:data") == 1
