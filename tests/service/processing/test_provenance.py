"""The provenance of a model: in replays, in recordings of other origin, and in the library."""

import hashlib
import json
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest

from cell.recording import RecordingWriter, read_recording
from cell.simulation.offline_scan import SimulatedScan, simulate
from cell.simulation.rendering.depth_camera import camera_model
from cell.simulation.scenes.scenes import make_scene
from recognition.model.model import PointChainModel
from recognition.model.provenance import Provenance
from recognition.pipeline import recognise
from recognition.request import RecognitionRequest
from service.batch.recognise_file import recognise_file
from service.processing.results import Source, recognise_recording
from tests.service.intensity_images import with_intensity


@pytest.fixture(scope="module")
def scan() -> SimulatedScan:
    scan = simulate(make_scene("arc", 1), camera_model("exact", (320, 200)), 1, views=4)
    return replace(scan, views=tuple(map(with_intensity, scan.views)))


def written(scan: SimulatedScan, path: Path, stamps: float | None = None, **changes: object) -> Path:
    """Write the recording of a scan with changes of its header, and with stamps from `stamps` on."""
    with RecordingWriter(path, replace(scan.header, **changes)) as writer:  # type: ignore[arg-type]
        for view in scan.views:
            writer.write_view(view if stamps is None else replace(view, stamp_s=stamps + view.index))
    return path


def test_a_simulated_recording(scan: SimulatedScan, tmp_path: Path) -> None:
    path = written(scan, tmp_path / "arc.mcap")
    assert read_recording(path).header.simulated is True
    model = recognise_recording(path, source=Source("a-scan", "ab" * 32)).model
    assert model.provenance == Provenance(
        release=version("pointchain"),
        scan="a-scan",
        # The stamps of simulated scans begin with the year 2026, one view every 3 s.
        captured_at="2026-01-01T00:00:09.000Z",
        recording_sha256="ab" * 32,
        calibration_sha256=None,
        simulated=True,
        intensity_views=4,
    )
    assert PointChainModel.from_json(model.to_json()).provenance == model.provenance


def test_a_recording_that_does_not_say_where_it_comes_from(scan: SimulatedScan, tmp_path: Path) -> None:
    """Imported views without a time have the stamps 0 s, 1 s, ..."""
    path = written(scan, tmp_path / "imported.mcap", 0.0, simulated=None)
    provenance = recognise_recording(path).model.provenance
    assert provenance == Provenance(release=version("pointchain"), intensity_views=4)


def test_views_without_an_intensity_image_give_the_same_model(scan: SimulatedScan, tmp_path: Path) -> None:
    views = [replace(view, intensity=None) if view.index else view for view in scan.views]
    without = recognise_recording(written(replace(scan, views=tuple(views)), tmp_path / "without.mcap")).model
    given = recognise_recording(written(scan, tmp_path / "with.mcap")).model
    assert without.provenance is not None
    assert without.provenance.intensity_views == 1
    documents = [model.to_json() for model in (without, given)]
    for document in documents:
        del document["provenance"], document["timing_s"]
    assert documents[0] == documents[1]


def test_models_of_earlier_releases_do_not_count_intensity_images(scan: SimulatedScan, tmp_path: Path) -> None:
    document = recognise_recording(written(scan, tmp_path / "arc.mcap")).model.to_json()
    del document["provenance"]["intensity_views"]
    provenance = PointChainModel.from_json(document).provenance
    assert provenance is not None
    assert provenance.intensity_views is None
    assert "intensity_views" not in PointChainModel.from_json(document).to_json()["provenance"]


def test_the_calibration_of_the_recording_is_named(scan: SimulatedScan, tmp_path: Path) -> None:
    path = written(scan, tmp_path / "real.mcap", simulated=False, provenance={"calibration_sha256": "cd" * 32})
    provenance = recognise_recording(path).model.provenance
    assert provenance is not None
    assert (provenance.calibration_sha256, provenance.simulated) == ("cd" * 32, False)


def test_the_command_line_names_the_recording(scan: SimulatedScan, tmp_path: Path) -> None:
    path = written(scan, tmp_path / "arc.mcap")
    document = json.loads(recognise_file(str(path), RecognitionRequest()).text)
    assert document["provenance"]["recording_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert document["provenance"]["scan"] is None


def test_the_library_gives_no_provenance(scan: SimulatedScan) -> None:
    model = recognise(scan.views, RecognitionRequest(radius_m=0.0042)).model
    assert model.provenance is None
    assert "provenance" not in model.to_json()
