"""Reading single views of finished recordings and of a recording that is still being written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import MCAP0_MAGIC

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.recording import (
    RecordingCorruptError,
    RecordingError,
    RecordingHeader,
    RecordingHeaderError,
    RecordingWriter,
    read_recording,
)
from cell.recording.limits import DEFAULT_LIMITS
from cell.recording.view_reader import read_poses, read_view
from tests.cell.recording.jpeg import JPEG
from tests.cell.recording.test_foreign_recording import Foreign, depth_of

T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.05, 0.02, -1.55))
HEADER = RecordingHeader(1e-4, 0.0042, T_FLANGE_CAMERA, table_z_m=-0.01)


def make_view(index: int) -> View:
    """Return a view whose parts all depend on its index."""
    return View(
        index=index,
        depth=np.random.default_rng(index).integers(0, 1 << 16, (40, 64), dtype=np.uint16),
        depth_unit_m=1e-4,
        K=np.array([[60.0 + index, 0.0, 31.5], [0.0, 61.0, 19.5], [0.0, 0.0, 1.0]]),
        T_base_flange=from_rotation_vector((0.3, 0.01 * index, 0.4), (0.1 * index, 3.0, 0.1)),
        T_flange_camera=T_FLANGE_CAMERA,
        stamp_s=1.79e9 + 0.1 * index,
        colour_jpeg=JPEG,
        intensity=np.random.default_rng([index, 1]).integers(0, 256, (40, 64), dtype=np.uint8),
    )


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """Return a recording with the views 2, 0, 1, in this order."""
    path = tmp_path / "scan.mcap"
    with RecordingWriter(path, HEADER) as writer:
        for index in (2, 0, 1):
            writer.write_view(make_view(index))
    return path


def test_a_single_view_equals_that_of_the_whole_recording(written: Path) -> None:
    views, poses = read_recording(written).views, read_poses(written)
    assert [pose.index for pose in poses] == [0, 1, 2]
    for view, pose in zip(views, poses, strict=True):
        found = read_view(written, view.index)
        assert found is not None
        got, header = found
        np.testing.assert_array_equal(got.depth, view.depth)
        assert view.intensity is not None
        np.testing.assert_array_equal(got.intensity, view.intensity)
        np.testing.assert_array_equal(got.T_base_flange, view.T_base_flange)
        assert got.stamp_s == view.stamp_s
        assert header.table_z_m == -0.01
        np.testing.assert_array_equal(pose.T_base_camera, view.T_base_camera)
        np.testing.assert_array_equal(pose.K, view.K)
        assert (pose.width, pose.height) == (64, 40)


def test_an_unknown_view_is_none(written: Path) -> None:
    assert read_view(written, 3) is None
    assert read_view(written, 999) is None


def test_an_unfinished_recording_has_its_complete_views(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    with RecordingWriter(path, HEADER) as writer:
        assert (read_poses(path), read_view(path, 0)) == ([], None)
        for index in (4, 1):
            writer.write_view(make_view(index))
            assert read_view(path, index) is not None
        assert [pose.index for pose in read_poses(path)] == [1, 4]
        before = path.stat().st_size
        writer.write_view(make_view(2))
        whole = path.read_bytes()
    # The state while view 2 is written, whose image has 5120 bytes that cannot be compressed.
    for cut in range(before, before + 5120, 197):
        path.write_bytes(whole[:cut])
        assert [pose.index for pose in read_poses(path)] == [1, 4]
        assert read_view(path, 1) is not None
        assert read_view(path, 2) is None


def test_a_recording_cut_anywhere_has_the_earlier_views(written: Path) -> None:
    content = written.read_bytes()
    places = np.random.default_rng(1).integers(0, len(content), 40).tolist()
    counts = set()
    for cut in [*places, len(content) - 1]:
        if cut < len(MCAP0_MAGIC):  # not even the magic bytes
            continue
        written.write_bytes(content[:cut])
        try:
            whole = [view.index for view in read_recording(written).views]
        except RecordingError:  # no complete view
            whole = []
        counts.add(len(whole))
        assert [pose.index for pose in read_poses(written)] == sorted(whole)
        assert [index for index in range(3) if read_view(written, index) is not None] == sorted(whole)
    assert counts == {0, 1, 2, 3}


@pytest.mark.parametrize("index", [0, 1, 2])
def test_other_writers_may_use_another_order(tmp_path: Path, index: int) -> None:
    """Everything that a reader of whole recordings accepts, a reader of views accepts too."""
    path = tmp_path / "f.mcap"
    foreign = Foreign(header_last=True, writer={"chunk_size": 1})  # so that there is more than one chunk
    foreign.messages.reverse()
    path.write_bytes(foreign.bytes())
    found = read_view(path, index)
    assert found is not None
    np.testing.assert_array_equal(found[0].depth, depth_of(index))
    np.testing.assert_array_equal(read_poses(path)[index].T_base_camera, found[0].T_base_camera)


@pytest.mark.parametrize("topic", ["/tf", "/camera/calibration", "/camera/depth"])
def test_an_incomplete_view_is_omitted(tmp_path: Path, topic: str) -> None:
    path, foreign = tmp_path / "f.mcap", Foreign()
    foreign.messages = [message for message in foreign.messages if message[:2] != (1, topic)]
    path.write_bytes(foreign.bytes())
    assert [pose.index for pose in read_poses(path)] == [0, 2]
    assert [read_view(path, index) is not None for index in range(3)] == [True, False, True]


@pytest.mark.parametrize("lacking", ["metadata_records", "attachments"])
def test_a_recording_without_a_header_is_refused(tmp_path: Path, lacking: str) -> None:
    path = tmp_path / "f.mcap"
    path.write_bytes(replace(Foreign(), **{lacking: 0}).bytes())
    for read in (read_poses, lambda path: read_view(path, 0)):
        with pytest.raises(RecordingHeaderError):
            read(path)


def test_the_data_after_a_view_are_not_read(written: Path) -> None:
    """The first view takes the same time in a long recording."""
    content = written.read_bytes()
    half = len(content) // 2
    written.write_bytes(content[:half] + bytes(byte ^ 0xFF for byte in content[half:]))
    assert read_view(written, 2) is not None
    with pytest.raises(RecordingCorruptError):
        read_poses(written)


def test_the_view_reader_enforces_the_limits(written: Path) -> None:
    limits = replace(DEFAULT_LIMITS, image_pixels=64 * 40 - 1)
    with pytest.raises(ValueError, match="2559 at most"):
        read_view(written, 0, limits)
    assert len(read_poses(written, limits)) == 3  # poses need no image
