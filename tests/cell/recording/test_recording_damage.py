"""Recordings of killed scans, and truncated or damaged ones: complete views are kept, and no view is wrong."""

import io
import json
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.recording import RecordingError, RecordingHeader, RecordingWriter, read_recording
from tests.cell.recording.jpeg import JPEG

ROOT = Path(__file__).parents[3]
T_FLANGE_CAMERA = from_rotation_vector((0.03, -0.06, 0.05), (0.05, 0.02, -1.55))
HEADER = RecordingHeader(1e-4, 0.0042, T_FLANGE_CAMERA, provenance={"camera": "made"})
VIEWS = 5


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
        stamp_s=1.79e9 + 0.1 * index,
        colour_jpeg=JPEG if index % 2 else None,
    )


def assert_right(got: View) -> None:
    """Check that the parts of a view in its own chunk are as they were written."""
    wanted = make_view(got.index)
    np.testing.assert_array_equal(got.depth, wanted.depth)
    np.testing.assert_array_equal(got.K, wanted.K)
    # The quaternion has a few rounding errors of doubles.
    np.testing.assert_allclose(got.T_base_flange, wanted.T_base_flange, rtol=0, atol=1e-14)
    assert got.stamp_s == wanted.stamp_s


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a finished recording."""
    path = tmp_path_factory.mktemp("written") / "scan.mcap"
    with RecordingWriter(path, HEADER) as writer:
        for index in range(VIEWS):
            writer.write_view(make_view(index))
    return path.read_bytes()


def chunks(recording: bytes) -> list[ChunkIndex]:
    """Return the position of the chunk of each view, from the reader of mcap."""
    summary = make_reader(io.BytesIO(recording)).get_summary()
    assert summary is not None
    return summary.chunk_indexes


CHILD = """
import json, sys
from pathlib import Path
import numpy as np
from calibration.geometry.transforms import from_rotation_vector
from cell.devices import View
from cell.recording import RecordingHeader, RecordingWriter

T = np.array(json.loads(sys.argv[2]))
writer = RecordingWriter(Path(sys.argv[1]), RecordingHeader(1e-4, 0.0042, T))
for k in range(64):
    depth = np.random.default_rng(k).integers(0, 1 << 16, (40, 64), dtype=np.uint16)
    K = np.array([[60, 0, 31.5], [0, 61, 19.5], [0, 0, 1.0]])
    writer.write_view(View(k, depth, 1e-4, K, np.eye(4), T))
    print(k, flush=True)
"""


def test_a_killed_process_keeps_every_view_it_acknowledged(tmp_path: Path) -> None:
    acknowledged = 4
    path = tmp_path / "scan.mcap"
    command = [sys.executable, "-c", CHILD, str(path), json.dumps(T_FLANGE_CAMERA.tolist())]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        for k in range(acknowledged):
            assert child.stdout.readline() == f"{k}\n"
        child.kill()
    assert child.returncode == -signal.SIGKILL
    recording = read_recording(path)
    # The process may have finished more views before the signal.
    assert len(recording.views) >= acknowledged
    for view in recording.views:
        np.testing.assert_array_equal(view.depth, make_view(view.index).depth)
    assert f"anything after view {len(recording.views) - 1} is lost" in recording.missing[-1]


def test_an_interrupted_scan_is_reported(tmp_path: Path) -> None:
    def break_off() -> None:
        with RecordingWriter(tmp_path / "scan.mcap", HEADER) as writer:
            writer.write_view(make_view(0))
            writer.write_view(make_view(2))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    recording = read_recording(tmp_path / "scan.mcap")
    assert [view.index for view in recording.views] == [0, 2]
    assert recording.missing == (
        "view 1 is not in the file",
        "the recording is cut off: it has 2 complete views, and anything after view 2 is lost; scan again, or copy "
        "the file again if its copy is incomplete (the file has no end record)",
    )


def test_viewpoints_that_were_not_needed_are_not_missing(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "scan.mcap", replace(HEADER, views_as_needed=True)) as writer:
        for index in (1, 3):
            writer.write_view(make_view(index))
    recording = read_recording(tmp_path / "scan.mcap")
    assert [view.index for view in recording.views] == [1, 3]
    assert recording.missing == ()


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """Limit the size of files to `size` bytes inside the context. A longer write fails like on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_keeps_the_earlier_views(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    writer = RecordingWriter(path, HEADER)
    writer.write_view(make_view(0))
    with room_for(path.stat().st_size + 1000):
        with pytest.raises(OSError, match="File too large"):
            writer.write_view(make_view(1))
        with pytest.raises(RecordingError, match="cannot be written any more"):
            writer.write_view(make_view(2))
        writer.close()
    recording = read_recording(path)
    assert [view.index for view in recording.views] == [0]
    assert "the file ends inside the record" in recording.missing[0]


def test_a_full_disk_at_the_end_keeps_all_views(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    writer = RecordingWriter(path, HEADER)
    writer.write_view(make_view(0))
    with room_for(path.stat().st_size + 5), pytest.raises(OSError, match="File too large"):
        writer.close()
    writer.close()
    recording = read_recording(path)
    assert [view.index for view in recording.views] == [0]
    assert "anything after view 0 is lost" in recording.missing[0]


def test_a_recording_that_cannot_be_started_leaves_no_file(tmp_path: Path) -> None:
    with room_for(100), pytest.raises(OSError, match="File too large"):
        RecordingWriter(tmp_path / "scan.mcap", HEADER)
    assert list(tmp_path.iterdir()) == []


def test_a_file_cut_anywhere_keeps_its_complete_views(written: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    ends = [chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks(written)]
    footer_bytes = 9 + 20 + 8
    places = np.random.default_rng(1).integers(0, len(written) - footer_bytes, 50).tolist()
    for cut in [*places, *ends, *(end - 1 for end in ends), len(written) - 1]:
        path.write_bytes(written[:cut])
        complete = sum(end <= cut for end in ends)
        if complete == 0:
            with pytest.raises(RecordingError):
                read_recording(path)
            continue
        recording = read_recording(path)
        assert [view.index for view in recording.views] == list(range(complete))
        for view in recording.views:
            assert_right(view)
        if complete < len(ends):
            assert f"anything after view {complete - 1} is lost" in recording.missing[0]


def test_a_truncated_or_zero_filled_end_keeps_the_earlier_views(written: bytes, tmp_path: Path) -> None:
    path = tmp_path / "truncated.mcap"
    last = chunks(written)[-1]
    end = last.chunk_start_offset + last.chunk_length
    truncated = bytearray(written[:end])
    truncated[-500:] = bytes(500)
    for data in (bytes(truncated), written[: last.chunk_start_offset] + bytes(2 << 20)):
        path.write_bytes(data)
        recording = read_recording(path)
        assert [view.index for view in recording.views] == [0, 1, 2, 3]
        assert "anything after view 3 is lost" in recording.missing[0]


@pytest.mark.parametrize("finished", [True, False])
def test_flipped_bytes_never_give_wrong_views(written: bytes, tmp_path: Path, finished: bool) -> None:
    path = tmp_path / "flipped.mcap"
    last = chunks(written)[-1]
    data = written if finished else written[: last.chunk_start_offset + last.chunk_length]
    rng = np.random.default_rng(7)
    refused = 0
    for trial in range(200):
        flipped = np.frombuffer(data, dtype=np.uint8).copy()
        # Every second trial changes the first kibibytes, which have the header, schemas and channels.
        reach = len(flipped) if trial % 2 else 2000
        places = rng.integers(0, reach, 1 + trial % 4)
        flipped[places] ^= rng.integers(1, 256, len(places), dtype=np.uint8)
        path.write_bytes(flipped.tobytes())
        try:
            recording = read_recording(path)
        except RecordingError:
            refused += 1
            continue
        for view in recording.views:
            assert_right(view)
        # In an unfinished file only chunks have a checksum, so a change of its header is not detected.
        if finished and not recording.missing:
            assert len(recording.views) == VIEWS
            assert recording.header.provenance == HEADER.provenance
            np.testing.assert_array_equal(recording.header.T_flange_camera, T_FLANGE_CAMERA)
    assert refused >= 100
