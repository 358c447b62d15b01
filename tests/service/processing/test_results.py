"""Recognition of a recording and the files of its result, without HTTP."""

import hashlib
import io
import json
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from recognition.grasping.gripper import Gripper
from recognition.model.chains import Chain, Crossing, StrandPoint
from recognition.model.model import PointChainModel
from recognition.parameters import ChainParameters
from recognition.request import RecognitionRequest
from recognition.stage_timer import STAGES, stages_of
from service.processing.preview import draw_preview
from service.processing.results import (
    READING,
    STAGE_START_FRACTION,
    WRITING,
    merged_cloud,
    recognise_recording,
    to_ply,
    write_model,
    write_results,
)


def test_a_recording_becomes_the_files_of_a_result(recording_file: Path, tmp_path: Path) -> None:
    stages: list[str] = []
    recognition = recognise_recording(recording_file, on_stage=stages.append)
    assert stages == [READING, *stages_of("graph")]
    outcome = write_model(write_results(recognition, tmp_path / "out"), tmp_path / "out", "ab" * 32)
    assert (outcome.chains, outcome.crossings, outcome.partial) == (1, 0, False)

    written = json.loads((tmp_path / "out" / "model.json").read_text())
    expected = recognition.model.to_json()
    expected["provenance"]["recording_sha256"] = "ab" * 32
    assert written == json.loads(json.dumps(expected))
    for name, file in outcome.files.items():
        content = (tmp_path / "out" / name).read_bytes()
        assert file == {"sha256": hashlib.sha256(content).hexdigest(), "size_bytes": len(content)}
    assert set(outcome.files) == {path.name for path in (tmp_path / "out").iterdir()}
    # the string is free: there is a grasp every 5 mm, except within the fingers' width of the ends
    assert len(written["grasps"]) > 70
    # the scene is one string of 0.4 m with r = 4.2 mm on the table
    (chain,) = written["chains"]
    assert chain["length_m"] == pytest.approx(0.4, abs=0.012)
    assert np.median(np.array(chain["points"])[:, 2]) == pytest.approx(0.0042, abs=0.001)

    import open3d

    cloud = np.asarray(open3d.io.read_point_cloud(tmp_path / "out" / "cloud.ply").points)
    # float32 of coordinates below one metre
    np.testing.assert_allclose(cloud, merged_cloud(recognition), atol=1e-7)
    assert len(cloud) > 500


def test_a_gripper_too_small_for_the_string_gives_a_note(recording_file: Path) -> None:
    model = recognise_recording(recording_file, RecognitionRequest(gripper=Gripper(stroke_m=0.008))).model
    assert model.grasps == ()
    (note,) = [found for found in model.quality.findings if found.code == "no-grasp"]
    assert (note.severity, note.chains) == ("note", (0,))
    assert "the gripper opens 8.0 mm" in note.message


def test_a_truncated_file_gives_a_note(recording_file: Path, tmp_path: Path) -> None:
    content = recording_file.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) * 3 // 4])
    model = recognise_recording(cut).model
    (note,) = [found for found in model.quality.findings if found.code == "recording-incomplete"]
    assert note.severity == "note"
    assert "the file ends" in note.message


def test_the_start_fractions_cover_all_stages_and_increase() -> None:
    assert tuple(STAGE_START_FRACTION) == (READING, *STAGES, WRITING)
    fractions = list(STAGE_START_FRACTION.values())
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] <= fractions[-1] < 1


def test_an_empty_cloud_is_a_valid_file() -> None:
    content = to_ply(np.zeros((0, 3)))
    assert b"element vertex 0\n" in content
    assert content.endswith(b"end_header\n")


def crossed_model() -> PointChainModel:
    """Return a model of a string along x, and one along y above it."""
    line = np.linspace(-0.1, 0.1, 51)
    flat, n = np.zeros_like(line), len(line)
    sure, seen = np.full(n, 1e-4), np.full(n, 4)
    under = Chain(0, False, 0.004, np.column_stack([line, flat, flat + 0.004]), sure, seen, ("free", "free"))
    over = Chain(1, False, 0.004, np.column_stack([flat, line, flat + 0.012]), sure, seen, ("free", "free"))
    crossing = Crossing(0, np.array([0, 0, 0.008]), StrandPoint(1, 0.1), StrandPoint(0, 0.1), 0.008, np.pi / 2, 1, 0.9)
    return PointChainModel("enhanced", ChainParameters.for_radius(0.004), (under, over), (crossing,))


def preview_pixels(model: PointChainModel, points: np.ndarray) -> np.ndarray:
    return matplotlib.image.imread(io.BytesIO(draw_preview(model, points)), format="png")[..., :3]


def test_the_under_strand_has_a_gap_in_the_preview() -> None:
    pixels = preview_pixels(crossed_model(), np.zeros((0, 3)))
    assert pixels.shape == (600, 800, 3)
    coloured = np.ptp(pixels, axis=2) > 0.3
    rows, columns = np.nonzero(coloured)
    # the strands cross in the middle of the coloured area, away from the label and the dot
    row, column = (rows.min() + rows.max()) // 2, (columns.min() + columns.max()) // 2
    gap = slice(column - 11, column - 6)
    assert coloured[row - 40 : row - 20, column - 5 : column + 5].any(), "the over strand runs up to the crossing"
    assert not coloured[row - 3 : row + 4, gap].any(), "the under strand has a gap beside it"
    assert coloured[row - 3 : row + 4, column - 80 : column - 60].any(), "and continues further away"


def test_the_preview_of_an_empty_model_is_an_image() -> None:
    empty = PointChainModel("enhanced", ChainParameters.for_radius(0.004))
    pixels = preview_pixels(empty, np.zeros((0, 3)))
    assert pixels.min() < 0.1  # the text "no string in view"
