"""`pointchain camera-profile`: a recording becomes a camera file."""

from pathlib import Path

import numpy as np
import pytest

from cell.config.camera_preset import read_preset
from cell.recording import RecordingHeader, RecordingWriter, read_recording
from cell.simulation.offline_scan import simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.cli.main import main
from service.interchange.camera_profile import has_single_exposures, pose_images

pytestmark = pytest.mark.slow


def recorded(path: Path, camera: str) -> Path:
    """Write two views of a simulated camera."""
    scan = simulate(make_scene("straight", 1), camera_model(camera), 1, views=2)
    with RecordingWriter(path, scan.header) as writer:
        for view in scan.views:
            writer.write_view(view)
    return path


def test_a_recording_becomes_a_camera_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "camera.json"
    recording = recorded(tmp_path / "scan.mcap", "oak-d-pro")
    assert main(["camera-profile", str(recording), str(out)]) == 0
    printed = capsys.readouterr().out
    assert "pixel locking" in printed
    assert "noise_factor is that of oak-d-pro: there is one image per pose" in printed
    preset = read_preset(out)
    assert preset.baseline_m == pytest.approx(0.075, rel=0.02)
    assert main(["camera-profile", str(recording), str(out)]) == 1
    assert "nothing is overwritten" in capsys.readouterr().err
    again = tmp_path / "again.mcap"
    assert main(["simulate", str(again), "--camera", str(out), "--views", "1"]) == 0
    assert read_recording(again).header.provenance["camera"] == "simulated oak-d-pro-profile"


def test_wrong_recordings_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "camera.json"
    assert main(["camera-profile", str(tmp_path / "none.mcap"), str(out)]) == 1
    assert "none.mcap" in capsys.readouterr().err
    assert main(["camera-profile", str(recorded(tmp_path / "ideal.mcap", "ideal")), str(out)]) == 1
    assert "shows no pixel locking" in capsys.readouterr().err
    scan = simulate(make_scene("straight", 1), camera_model("ideal"), 1, views=1)
    (view,) = scan.views
    nothing = view.__class__(
        view.index, np.zeros_like(view.depth), view.depth_unit_m, view.K, view.T_base_flange, view.T_flange_camera
    )
    empty = tmp_path / "empty.mcap"
    with RecordingWriter(empty, scan.header) as writer:
        writer.write_view(nothing)
    assert main(["camera-profile", str(empty), str(out)]) == 1
    assert "no image shows a table" in capsys.readouterr().err
    assert main(["camera-profile", str(empty), str(tmp_path / "camera.txt")]) == 1
    assert "must end with .json" in capsys.readouterr().err
    assert not out.exists()


def test_images_of_one_pose_belong_together(tmp_path: Path) -> None:
    scan = simulate(make_scene("straight", 1), camera_model("ideal"), 1, views=2)
    first, second = scan.views
    groups = pose_images([first, second, first])
    assert [len(group.depth) for group in groups] == [2, 1]


def test_imported_images_are_single_exposures() -> None:
    header = RecordingHeader(0.001, None, np.eye(4), provenance={"source": "depth images"})
    assert has_single_exposures(header.provenance)
    assert not has_single_exposures({"camera": "OAK-D"})
