"""Files that are not recordings, are damaged, or announce more bytes than they have."""

import json
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC

from cell.devices import View
from cell.recording import (
    Limits,
    NotMcapError,
    RecordingCorruptError,
    RecordingHeader,
    RecordingHeaderError,
    RecordingTooLargeError,
    RecordingUnreadableError,
    RecordingWriter,
    read_recording,
)

ROOT = Path(__file__).parents[3]
WIDTH, HEIGHT = 64, 40
IMAGE_BYTES = 2 * WIDTH * HEIGHT


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return a finished recording of three views with incompressible images."""
    path = tmp_path_factory.mktemp("written") / "scan.mcap"
    K = np.array([[60, 0, 31.5], [0, 61, 19.5], [0, 0, 1]])
    with RecordingWriter(path, RecordingHeader(0.001, 0.003, np.eye(4))) as writer:
        for k in range(3):
            depth = np.random.default_rng(k).integers(0, 1 << 16, (HEIGHT, WIDTH), dtype=np.uint16)
            writer.write_view(View(k, depth, 0.001, K, np.eye(4), np.eye(4)))
    return path.read_bytes()


def record(opcode: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def chunk(compression: str, data: bytes, size: int) -> bytes:
    builder = RecordBuilder()
    Chunk(compression, data, 0, 0, 0, size).write(builder)
    return builder.end()


def test_a_file_that_is_not_mcap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    with pytest.raises(RecordingUnreadableError, match=r"f\.mcap cannot be read: No such file"):
        read_recording(path)
    with pytest.raises(RecordingUnreadableError, match="is not a file"):
        read_recording(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordingUnreadableError, match="pipe is not a file"):
        read_recording(tmp_path / "pipe")
    path.write_bytes(b"")
    with pytest.raises(NotMcapError, match=r"f\.mcap is empty"):
        read_recording(path)
    for content in (b"\x89", b"PK\x03\x04 a zip file", b"{}" * 1000):
        path.write_bytes(content)
        with pytest.raises(NotMcapError, match=r"f\.mcap is not an MCAP file"):
            read_recording(path)
    path.write_bytes(MCAP0_MAGIC)
    with pytest.raises(RecordingHeaderError, match=re.escape("metadata (the file has no end record)")):
        read_recording(path)


def test_damage_before_the_end_is_refused(written: bytes, tmp_path: Path) -> None:
    path = tmp_path / "f.mcap"
    changed = bytearray(written)
    changed[2 * len(written) // 3] ^= 1  # within the chunk of the second view
    path.write_bytes(changed)
    with pytest.raises(RecordingCorruptError, match=r"the chunk at byte \d+ (fails its checksum|does not)"):
        read_recording(path)
    path.write_bytes(written.replace(b"depth_unit_m\5\0\0\x000.001", b"depth_unit_m\5\0\0\x000.002"))
    with pytest.raises(RecordingCorruptError, match="fails its checksum: it was changed"):
        read_recording(path)
    path.write_bytes(written.replace(b"[[1.0, 0.0", b"[[2.0, 0.0"))
    with pytest.raises(RecordingCorruptError, match=r"the attachment at byte \d+ fails its checksum"):
        read_recording(path)
    # A value announces more bytes than its record has. mcap alone would return the existing part.
    path.write_bytes(written.replace(b"table_z_m\3\0\0\0", b"table_z_m\4\0\0\0"))
    with pytest.raises(RecordingCorruptError, match=r"the record at byte \d+ is damaged: it is too short"):
        read_recording(path)
    path.write_bytes(MCAP0_MAGIC + chunk("", record(0x05, b"", 100), 9) + written[8:])
    with pytest.raises(RecordingCorruptError, match="a record in the chunk at byte 8 is longer"):
        read_recording(path)
    path.write_bytes(MCAP0_MAGIC + chunk("", b"\5\0\0", 3) + written[8:])
    with pytest.raises(RecordingCorruptError, match="a record in the chunk at byte 8 is longer"):
        read_recording(path)
    path.write_bytes(written.replace(b"zstd", b"lzma"))
    with pytest.raises(RecordingCorruptError, match="is compressed by 'lzma'; zstd, lz4 or none is read"):
        read_recording(path)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (Limits(file_bytes=10_000), r"f\.mcap has \d+ bytes; 10000 at most"),
        (Limits(content_bytes=2 * IMAGE_BYTES), f"holds more than {2 * IMAGE_BYTES} bytes"),
        (Limits(chunk_bytes=IMAGE_BYTES), r"the chunk at byte \d+ announces \d+ bytes"),
        (Limits(record_bytes=3000), r"record at byte \d+ announces \d+ bytes; 3000 at most"),
        (Limits(metadata_bytes=50), r"record at byte \d+ announces \d+ bytes; 50 at most"),
        (Limits(records=15), "more than 15 records"),
        (Limits(views=2), r"view 2 \(/tf\): .* from 0 to 1"),
        (Limits(image_pixels=WIDTH * HEIGHT - 1), "view 0: the depth image announces 64x40"),
        (Limits(attachment_bytes=50), r"hand_eye\.json has \d+ bytes; 50 at most"),
    ],
)
def test_limits_are_enforced(written: bytes, tmp_path: Path, limits: Limits, message: str) -> None:
    path = tmp_path / "f.mcap"
    path.write_bytes(written)
    assert len(read_recording(path).views) == 3
    with pytest.raises(RecordingTooLargeError, match=message):
        read_recording(path, limits)


def zstd_bomb(content_size: int | None) -> bytes:
    """Return a zstd frame (RFC 8878) of run-length blocks that expand to 1 GiB, or a byte with an announced size."""
    if content_size is not None:
        return b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", content_size) + b"\1\0\0"
    run, last = ((1 << 17) << 3 | 1 << 1), 1
    blocks = run.to_bytes(3, "little") + b"\0"
    return b"\x28\xb5\x2f\xfd\0\x58" + blocks * 8191 + (run | last).to_bytes(3, "little") + b"\0"


def lz4_bomb() -> bytes:
    """Return an LZ4 frame that expands to 512 MiB."""
    compressor = lz4.frame.LZ4FrameCompressor()
    zeros = bytes(16 << 20)
    return b"".join([compressor.begin(), *(compressor.compress(zeros) for _ in range(32)), compressor.flush()])


MEASURE = """
import json, resource, sys
from pathlib import Path
from cell.recording import RecordingError, read_recording

read = {}
for name in sys.argv[1:]:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        read_recording(Path(name))
        slug, message = None, ""
    except RecordingError as error:
        slug, message = error.slug, str(error)
    read[Path(name).stem] = slug, message, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
print(json.dumps(read))
"""


def test_announced_sizes_and_bombs_use_little_memory(written: bytes, tmp_path: Path) -> None:
    many = zstandard.compress(record(0x7F, b"") * (3 << 20))
    files = {
        "record": record(0x80, b"", 2**62),
        "record of all": record(0x05, b"", 2**64 - 1),
        "attachment": record(0x09, struct.pack("<QQIIQ", 0, 0, 0, 0, 2**62)),
        "metadata": record(0x0C, struct.pack("<II", 0, 2**32 - 1)),
        "metadata string": record(0x0C, struct.pack("<I", 2**32 - 1)),
        "chunk": chunk("zstd", b"", 2**40),
        "chunk data": record(0x06, struct.pack("<QQQIIQ", 0, 0, 9, 0, 0, 2**63)),
        "zstd": chunk("zstd", zstd_bomb(None), 1 << 20),
        "zstd announced": chunk("zstd", zstd_bomb(2**40), 1 << 20),
        "lz4": chunk("lz4", lz4_bomb(), 1 << 20),
        "many records": chunk("zstd", many, 27 << 20),
        "record in chunk": chunk("", record(0x05, b"", 2**63), 9),
    }
    paths = []
    for name, content in files.items():
        paths.append(tmp_path / f"{name}.mcap")
        # The end of the file follows, so that the damaged record is not the last one.
        paths[-1].write_bytes(MCAP0_MAGIC + content + written[8:])
    command = [sys.executable, "-c", MEASURE, *map(str, paths)]
    out = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    read = json.loads(out)
    corrupt = {"attachment", "metadata", "metadata string", "chunk data", "zstd", "zstd announced", "lz4"}
    for name, (slug, message, growth_kib) in read.items():
        assert slug == ("recording-corrupt" if name in corrupt else "recording-too-large"), (name, message)
        # Each may hold at most one chunk of 32 MiB, its copy and its compressed form.
        assert growth_kib < 100 << 10, (name, growth_kib)
    assert set(read) == set(files)


def test_the_bombs_expand_to_their_size() -> None:
    stream = zstandard.ZstdDecompressor().stream_reader(zstd_bomb(None))
    grown = 0
    while block := stream.read(16 << 20):
        grown += len(block)
    assert grown == 1 << 30
    assert zstandard.get_frame_parameters(zstd_bomb(2**40)).content_size == 2**40
