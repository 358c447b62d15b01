"""Recordings that this project writes are read back unchanged, here and by other readers."""

import hashlib
import json
import os
import stat
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.recording import (
    Limits,
    RecordingContentError,
    RecordingEmptyError,
    RecordingError,
    RecordingExistsError,
    RecordingHeader,
    RecordingTooLargeError,
    RecordingWriter,
    read_recording,
    read_result,
)
from cell.recording.limits import MIB
from tests.cell.recording.jpeg import JPEG

T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.05, 0.02, -1.55))
HEADER = RecordingHeader(
    depth_unit_m=1e-4,
    string_radius_m=0.0042,
    T_flange_camera=T_FLANGE_CAMERA,
    table_z_m=-0.01,
    workspace_m=((-0.3, 0.3), (-0.2, 0.2), (0.0, 0.1)),
    provenance={"camera": "made", "seed": "3"},
)
MODEL = {
    "schema": "pointchain/2",
    "frame": "base",
    "chains": [
        {
            "id": 0,
            "closed": False,
            "radius_m": 0.004,
            "points": [[0, 0, 0.004], [0.004, 0, 0.004], [0.008, 0, 0.01]],
        }
    ],
    "crossings": [
        {
            "id": 0,
            "point": [0.004, 0, 0.008],
            "over": {"chain": 0, "s_m": 0.26},
            "under": {"chain": 0, "s_m": 0.06},
            "sign": -1,
        }
    ],
}


def make_view(index: int) -> View:
    """Return a view whose parts all depend on its index."""
    rng = np.random.default_rng(index)
    return View(
        index=index,
        depth=rng.integers(0, 1 << 16, (40, 64), dtype=np.uint16),
        depth_unit_m=1e-4,
        K=np.array([[60.0 + index, 0.0, 31.5], [0.0, 61.0, 19.5], [0.0, 0.0, 1.0]]),
        T_base_flange=from_rotation_vector((0.3, 0.01 * index, 0.4), (0.1 * index, 3.0, 0.1)),
        T_flange_camera=T_FLANGE_CAMERA,
        stamp_s=1781327023.9200273 + 0.1 * index,  # multiplied by 1e9 and rounded to a double, it is another stamp
        colour_jpeg=JPEG if index % 2 else None,
        intensity=None if index == 1 else rng.integers(0, 256, (40, 64), dtype=np.uint8),
    )


def write(path: Path, views: list[View], header: RecordingHeader = HEADER) -> Path:
    with RecordingWriter(path, header) as writer:
        for view in views:
            writer.write_view(view)
    return path


def assert_same(got: View, wanted: View) -> None:
    assert got.index == wanted.index
    assert got.depth.dtype == np.uint16
    np.testing.assert_array_equal(got.depth, wanted.depth)
    np.testing.assert_array_equal(got.K, wanted.K)
    np.testing.assert_array_equal(got.T_flange_camera, wanted.T_flange_camera)
    # Poses pass through a quaternion, with a few rounding errors of doubles, in metres.
    np.testing.assert_allclose(got.T_base_flange, wanted.T_base_flange, rtol=0, atol=1e-14)
    assert got.depth_unit_m == wanted.depth_unit_m
    assert got.stamp_s == wanted.stamp_s
    assert got.colour_jpeg == wanted.colour_jpeg
    if wanted.intensity is None:
        assert got.intensity is None
        return
    assert got.intensity is not None
    assert got.intensity.dtype == np.uint8
    np.testing.assert_array_equal(got.intensity, wanted.intensity)


def test_a_recording_is_read_as_it_was_written(tmp_path: Path) -> None:
    views = [make_view(k) for k in (2, 0, 1)]
    recording = read_recording(write(tmp_path / "scan.mcap", views))
    assert recording.missing == ()
    assert [view.index for view in recording.views] == [0, 1, 2]
    for view in recording.views:
        assert_same(view, make_view(view.index))
    header = recording.header
    np.testing.assert_array_equal(header.T_flange_camera, T_FLANGE_CAMERA)
    assert (header.depth_unit_m, header.string_radius_m, header.table_z_m) == (1e-4, 0.0042, -0.01)
    assert header.workspace_m == HEADER.workspace_m
    assert header.provenance == {"camera": "made", "seed": "3"}


def test_paths_may_be_strings(tmp_path: Path) -> None:
    path = str(tmp_path / "scan.mcap")
    with RecordingWriter(path, HEADER) as writer:
        writer.write_view(make_view(0))
    assert len(read_recording(path).views) == 1
    assert read_result(path) is None


def test_an_unknown_radius_and_workspace_are_omitted(tmp_path: Path) -> None:
    header = RecordingHeader(depth_unit_m=1e-3, string_radius_m=None, T_flange_camera=T_FLANGE_CAMERA)
    path = write(tmp_path / "scan.mcap", [replace(make_view(0), depth_unit_m=1e-3)], header)
    got = read_recording(path).header
    assert (got.string_radius_m, got.workspace_m, got.table_z_m, got.provenance) == (None, None, 0.0, {})
    assert b"string_radius_m" not in path.read_bytes()


def rotations() -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, 3, elements=st.floats(-3, 3))


@st.composite
def views(draw: st.DrawFn) -> View:
    height, width = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    focal = st.floats(1, 1e5)
    return View(
        index=draw(st.integers(0, 63)),
        depth=draw(hnp.arrays(np.uint16, (height, width))),
        depth_unit_m=HEADER.depth_unit_m,
        K=np.array([[draw(focal), 0, width / 2], [0, draw(focal), height / 3], [0, 0, 1]]),
        T_base_flange=from_rotation_vector(draw(rotations()), draw(rotations())),
        T_flange_camera=T_FLANGE_CAMERA,
        # Stamps are stored in nanoseconds. Doubles are coarser than that from 2^23 s (97 days after the epoch) on.
        stamp_s=draw(st.just(0.0) | st.floats(2**23, 2**33, exclude_max=True)),
        colour_jpeg=draw(st.sampled_from([None, JPEG])),
    )


@settings(max_examples=25, deadline=None)
@given(st.lists(views(), min_size=1, max_size=3, unique_by=lambda view: view.index))
def test_any_views_are_read_as_they_were_written(made: list[View]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.mcap"
        with RecordingWriter(path, HEADER) as writer:
            returned = [writer.write_view(view) for view in made]
        recording = read_recording(path)
    assert [view.stamp_s for view in recording.views] == sorted(view.stamp_s for view in made)
    for got in recording.views:
        (wanted,) = (view for view in made if view.index == got.index)
        assert_same(got, wanted)
        # The view that the writer returns equals the view that is read.
        (same,) = (view for view in returned if view.index == got.index)
        np.testing.assert_array_equal(got.T_base_flange, same.T_base_flange)


def test_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for name in ("a.mcap", "b.mcap"):
        with RecordingWriter(tmp_path / name, HEADER) as writer:
            for k in range(3):
                writer.write_view(make_view(k))
            writer.write_result(MODEL)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]


def test_a_view_is_synced_to_disk_before_it_is_acknowledged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "scan.mcap"
    synced: list[tuple[bool, int]] = []

    def fsync(descriptor: int) -> None:
        status = os.fstat(descriptor)
        synced.append((stat.S_ISDIR(status.st_mode), status.st_size))

    monkeypatch.setattr(os, "fsync", fsync)
    with RecordingWriter(path, HEADER) as writer:
        assert any(is_directory for is_directory, _ in synced)
        for acknowledge in (lambda: writer.write_view(make_view(0)), lambda: writer.write_result(MODEL)):
            synced.clear()
            acknowledge()
            assert synced == [(False, path.stat().st_size)]
        synced.clear()
    assert synced == [(False, path.stat().st_size)]


def test_other_readers_open_a_recording(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "scan.mcap", HEADER) as writer:
        writer.write_view(make_view(0))
        writer.write_view(make_view(1))
        writer.write_result(MODEL)
    with (tmp_path / "scan.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert (summary.statistics.message_count, summary.statistics.chunk_count) == (10, 3)
        images = ["/camera/depth", "/camera/intensity", "/camera/color"]
        topics = ["/tf", "/camera/calibration", *images, "/result/scene"]
        decoded = {
            channel.topic: (message.sequence, content)
            for _, channel, message, content in reader.iter_decoded_messages(topics)
        }
        assert set(decoded) == set(topics)
        sequence, depth = decoded["/camera/depth"]
        assert (sequence, depth.encoding, depth.width, depth.height, depth.step) == (1, "16UC1", 64, 40, 128)
        assert depth.data == make_view(1).depth.astype("<u2").tobytes()
        sequence, intensity = decoded["/camera/intensity"]  # view 1 has none
        assert (sequence, intensity.encoding, intensity.step) == (0, "mono8", 64)
        assert (intensity.width, intensity.height) == (64, 40)
        line = decoded["/result/scene"][1].entities[0].lines[0]
        assert [(point.x, point.z) for point in line.points] == [(0, 0.004), (0.004, 0.004), (0.008, 0.01)]
        assert line.thickness == 0.008
        assert len(decoded["/result/scene"][1].entities[1].spheres) == 1
        assert [item.name for item in reader.iter_attachments()] == ["hand_eye.json"]


def test_the_last_result_is_read(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "scan.mcap", HEADER) as writer:
        writer.write_view(make_view(0))
        assert read_result(tmp_path / "scan.mcap") is None
        writer.write_result({**MODEL, "method": "matching"})
        writer.write_result({**MODEL, "method": "enhanced"})
    assert read_result(tmp_path / "scan.mcap") == {**MODEL, "method": "enhanced"}
    assert len(read_recording(tmp_path / "scan.mcap").views) == 1


def test_the_byte_range_of_each_view_has_its_content(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    with RecordingWriter(path, HEADER) as writer:
        pieces = []
        for index in (2, 0, 1):
            writer.write_view(make_view(index))
            pieces.append(writer.written(index))
            # The present state of the file, as after a crash.
            assert path.stat().st_size == pieces[-1].offset_bytes + pieces[-1].size_bytes
        with pytest.raises(RecordingContentError):
            writer.write_view(make_view(0))
        with pytest.raises(KeyError):
            writer.written(3)
        assert writer.written(2) == pieces[0]
        writer.write_result(MODEL)
    content = path.read_bytes()
    for piece in pieces:
        end = piece.offset_bytes + piece.size_bytes
        assert hashlib.sha256(content[piece.offset_bytes : end]).hexdigest() == piece.sha256
    for piece, following in pairwise(pieces):
        assert following.offset_bytes == piece.offset_bytes + piece.size_bytes
    # The file that is cut after the second view has these two views.
    (tmp_path / "cut.mcap").write_bytes(content[: pieces[2].offset_bytes])
    assert [view.index for view in read_recording(tmp_path / "cut.mcap").views] == [0, 2]


def test_a_model_with_nan_is_not_written(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "scan.mcap", HEADER) as writer:
        writer.write_view(make_view(0))
        with pytest.raises(RecordingContentError, match="cannot be written as JSON"):
            writer.write_result({**MODEL, "quality": float("nan")})
    assert read_result(tmp_path / "scan.mcap") is None


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.mcap", [make_view(0)])
    before = path.read_bytes()
    with pytest.raises(RecordingExistsError, match=r"scan\.mcap exists"):
        RecordingWriter(path, HEADER)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"index": 0}, RecordingContentError, "view 0 is already in the recording"),
        ({"index": 64}, RecordingTooLargeError, "view 64: view indices are from 0 to 63"),
        ({"index": -1}, RecordingTooLargeError, "view -1: view indices are from 0 to 63"),
        ({"depth_unit_m": 1e-3}, RecordingContentError, "depth unit is 0.001 m, that of the recording 0.0001 m"),
        ({"T_flange_camera": np.eye(4)}, RecordingContentError, "T_flange_camera differs from that of the recording"),
        ({"stamp_s": float("nan")}, RecordingContentError, "stamp nan s"),
        ({"stamp_s": -1.0}, RecordingContentError, "stamp -1.0 s"),
        ({"colour_jpeg": bytes(17 << 20)}, RecordingTooLargeError, "view 1 has .* bytes"),
        ({"depth": np.ones((2049, 2049), np.uint16)}, RecordingTooLargeError, "view 1: 4198401 pixels"),
    ],
)
def test_an_invalid_view_is_not_written(
    tmp_path: Path, change: dict[str, Any], error: type[RecordingError], message: str
) -> None:
    with RecordingWriter(tmp_path / "scan.mcap", HEADER) as writer:
        writer.write_view(make_view(0))
        with pytest.raises(error, match=message):
            writer.write_view(replace(make_view(1), **change))
        writer.write_view(make_view(2))
    assert [view.index for view in read_recording(tmp_path / "scan.mcap").views] == [0, 2]


def test_a_recording_accepts_no_more_views_than_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    views = [replace(make_view(index), intensity=None) for index in range(3)]
    two_views = 2 * views[0].depth.nbytes + MIB + 2000
    monkeypatch.setattr("cell.recording.writer.DEFAULT_LIMITS", Limits(content_bytes=two_views))
    with RecordingWriter(tmp_path / "scan.mcap", HEADER) as writer:
        writer.write_view(views[0])
        writer.write_view(views[1])
        with pytest.raises(RecordingTooLargeError, match="view 2: the recording is full"):
            writer.write_view(views[2])
    assert len(read_recording(tmp_path / "scan.mcap", Limits(content_bytes=two_views)).views) == 2


def test_a_recording_without_views_is_reported(tmp_path: Path) -> None:
    with pytest.raises(RecordingEmptyError, match="no complete view: it has no message of any view"):
        read_recording(write(tmp_path / "scan.mcap", []))


def test_the_stored_hand_eye_is_plain_json(tmp_path: Path) -> None:
    with write(tmp_path / "scan.mcap", [make_view(0)]).open("rb") as file:
        (attachment,) = make_reader(file).iter_attachments()
    assert json.loads(attachment.data) == {"T_flange_camera": T_FLANGE_CAMERA.tolist()}
