"""`pointchain import bag` makes a recording that gives the same model as the scan in the bag."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cell.recording import read_recording
from cell.simulation.offline_scan import SimulatedScan, simulate, write_simulation
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from service.cli.main import main
from service.processing.results import recognise_recording
from tests.cell.bag.bags import KINDS, Kind, Recorded, one_image_each, write_bag


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    """Return a scan of a crossing from four sides by a noisy camera with wrong poses."""
    return simulate(make_scene("loop", 2), camera_model("ideal", (320, 200)), 2, views=4)


@pytest.fixture(scope="module")
def model(scan: SimulatedScan, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the model of the recording that was written without a bag."""
    path = tmp_path_factory.mktemp("twin") / "twin.mcap"
    write_simulation(scan, path)
    return model_of(path)


def model_of(path: Path) -> dict[str, Any]:
    """Return each value of the model by its path in the document, without the times and the provenance."""
    document = replace(recognise_recording(path).model, timing_s={}, provenance=None).to_json()
    return dict(leaves(document, ""))


def leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict | list | tuple):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(part, f"{path}.{key}")
    else:
        yield path, value


def options(scan: SimulatedScan) -> list[str]:
    assert scan.header.workspace_m is not None
    box = [str(value) for side in scan.header.workspace_m for value in side]
    return ["--depth-unit=0.0001", "--radius=0.0042", "--workspace", *box]


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_gives_the_model_of_its_scan(
    scan: SimulatedScan,
    model: dict[str, Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    kind: Kind,
    encoding: str,
) -> None:
    bag = write_bag(
        tmp_path / ("scan.bag" if kind == "ros1" else "scan"), kind, one_image_each(scan.views, Recorded(encoding))
    )
    out = tmp_path / "out.mcap"
    assert main(["import", "bag", str(bag), str(out), *options(scan)]) == 0
    printed, report = capsys.readouterr()
    assert printed == ""
    assert "4 views of 1 images each; excluded are 0 images taken in motion and 0 without a known pose" in report
    assert "frames base (base), tool0 (flange), camera_depth_optical_frame (camera)" in report
    assert f"wrote {out}" in report
    # The quaternion of /tf changes the last bit of a pose. This may change the rounding: the micrometre of a position,
    # or the fourth digit of a score or confidence.
    imported = model_of(out)
    assert imported.keys() == model.keys()
    for path, value in model.items():
        if isinstance(value, float):
            last_digit = 1e-4 if path.endswith(("score", "confidence")) else 1e-6
            assert imported[path] == pytest.approx(value, rel=0, abs=1.01 * last_digit), path
        else:
            assert imported[path] == value, path


def test_a_bag_with_one_pose_gives_a_model_of_one_view(scan: SimulatedScan, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "scan.bag", "ros1", one_image_each(scan.views[1:2], Recorded()))
    out = tmp_path / "out.mcap"
    assert main(["import", "bag", str(bag), str(out), *options(scan)]) == 0
    model = recognise_recording(out).model
    assert len(model.quality.views) == 1
    (chain,) = model.chains
    assert chain.views.max() == 1
    assert "single-view" in {found.code for found in model.quality.findings}


def test_wrong_options_are_reported_and_nothing_is_written(
    scan: SimulatedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / "scan.bag", "ros1", one_image_each(scan.views[:2], Recorded()))
    out = tmp_path / "out.mcap"
    for arguments, message in [
        (
            ["--depth-topic=/a"],
            "pointchain import bag: there is no topic /a of type Image; --depth-topic may be: /camera",
        ),
        (["--hand-eye=none.json"], "there is no hand-eye calibration none.json"),
        (["--radius=-1"], "the string radius is -1 m; it must be positive"),
        (["--table-z=nan"], "table_z_m is nan; a finite number is needed"),
    ]:
        assert main(["import", "bag", str(bag), str(out), *arguments]) == 1
        assert message in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == ["scan.bag"]
    assert main(["import", "bag", str(bag), str(tmp_path / "none" / "out.mcap")]) == 1
    assert "out.mcap cannot be written: No such file or directory" in capsys.readouterr().err
    assert main(["import", "bag", str(bag), str(out)]) == 0
    before = out.read_bytes()
    assert main(["import", "bag", str(bag), str(out)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert out.read_bytes() == before


def test_a_hand_eye_file_replaces_tf(scan: SimulatedScan, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "hand_eye.json"
    file.write_text(json.dumps({"T_flange_camera": scan.header.T_flange_camera.tolist()}))
    bag = write_bag(tmp_path / "scan", "mcap", one_image_each(scan.views[:2], Recorded(static={})))
    out = tmp_path / "out.mcap"
    assert main(["import", "bag", str(bag), str(out)]) == 1
    assert "name a file by --hand-eye" in capsys.readouterr().err
    assert main(["import", "bag", str(bag), str(out), f"--hand-eye={file}"]) == 0
    header = read_recording(out).header
    assert header.T_flange_camera.tolist() == scan.header.T_flange_camera.tolist()
    assert header.provenance["hand_eye"].startswith("hand_eye.json ")


def test_help_needs_no_rosbags(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(SystemExit) as exit_info:
        main(["import", "bag", "--help"])
    assert exit_info.value.code == 0
    assert "--hand-eye JSON" in capsys.readouterr().out
