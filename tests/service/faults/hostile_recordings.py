"""Recordings with random damage or hostile content."""

import json
import random
import struct
from collections.abc import Callable

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Attachment, Chunk
from mcap.writer import MCAP0_MAGIC

from tests.cell.recording.test_foreign_recording import Foreign

ABSURD = (0, 1, 0x7F, 1 << 20, 2**31 - 1, 2**32, 2**40, 2**62, 2**63, 2**64 - 1)
NAMES = (
    "..", "../../hand_eye.json", "/etc/passwd", "/tmp/evil", "hand_eye.json\0.png", "C:\\evil", "\\\\host\\share",
    "../" * 100 + "evil", "a" * 60_000, "hand_eye.json/", "~/.ssh/authorized_keys", "$(touch evil)", "\u202e\ud7ff",
    "CON", "", ".", "lock", "pointchain.sqlite3", "-rf",
)  # fmt: skip
"""Hostile names of attachments and other items."""


def records(content: bytes) -> list[bytes]:
    """Return the top-level records of a recording, each with its header."""
    found, at = [], len(MCAP0_MAGIC)
    while at + 9 <= len(content) - len(MCAP0_MAGIC):
        size = 9 + struct.unpack_from("<Q", content, at + 1)[0]
        found.append(content[at : at + size])
        at += size
    return found


def hostile(content: bytes, number: int) -> tuple[str, bytes]:
    """Return kind and bytes of a recording made from the valid `content`; equal numbers give equal recordings."""
    rng = random.Random(number)
    kind = KINDS[number % len(KINDS)]
    return f"{kind.__name__.strip('_')} {number}", kind(content, rng)


def _flipped(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 5, 200))):
        changed[rng.randrange(8, len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content))]


def _zeros(content: bytes, rng: random.Random) -> bytes:
    begin = rng.randrange(8, len(content))
    return content[:begin] + bytes(min(rng.randrange(1, 50_000), len(content) - begin)) + content[begin + 50_000 :]


def _shuffled(content: bytes, rng: random.Random) -> bytes:
    parts = records(content)
    one, other = rng.randrange(len(parts)), rng.randrange(len(parts))
    parts[one], parts[other] = parts[other], parts[one]
    return MCAP0_MAGIC + b"".join(parts) + MCAP0_MAGIC


def _doubled(content: bytes, rng: random.Random) -> bytes:
    parts = records(content)
    one = rng.randrange(len(parts))
    return MCAP0_MAGIC + b"".join(parts[:one] + [parts[one]] * rng.choice((2, 3, 1000)) + parts[one:])[: 8 << 20]


def _absurd(content: bytes, rng: random.Random) -> bytes:
    """Set the length of a record, or a number in it, to an absurd value."""
    parts = records(content)
    one = rng.randrange(len(parts))
    part = bytearray(parts[one])
    at = 1 if rng.random() < 0.5 else rng.randrange(9, max(10, min(len(part) - 8, 200)))
    struct.pack_into("<Q", part := part + bytes(8), at, rng.choice(ABSURD))
    parts[one] = bytes(part[:-8])
    return MCAP0_MAGIC + b"".join(parts) + MCAP0_MAGIC


def _named(content: bytes, rng: random.Random) -> bytes:
    """Insert attachments with hostile names."""
    builder = RecordBuilder()
    for name in rng.sample(NAMES, 4):
        Attachment(0, 0, name, "application/json", b"evil").write(builder)
    return MCAP0_MAGIC + builder.end() + content[8:]


def _bomb(content: bytes, rng: random.Random) -> bytes:
    """Insert a decompression bomb, or nested ones."""
    grown = zstandard.compress(bytes(rng.choice((33, 200)) << 20), level=1)
    for _ in range(rng.randrange(3)):
        inner = RecordBuilder()
        Chunk("zstd", grown, 0, 0, 0, rng.choice(ABSURD)).write(inner)
        grown = zstandard.compress(inner.end())
    builder = RecordBuilder()
    Chunk(rng.choice(("zstd", "lz4", "", "evil")), grown, 0, 0, 0, rng.choice(ABSURD)).write(builder)
    return MCAP0_MAGIC + builder.end() + content[8:]


def _claims(content: bytes, rng: random.Random) -> bytes:
    """Make a complete recording whose messages claim wrong sizes or values."""
    foreign = Foreign()
    depth, pose = foreign.find(1, "/camera/depth"), foreign.find(1, "/tf")
    numbers: tuple[Callable[[], None], ...] = (
        lambda: setattr(depth, "width", rng.choice((0, 1, 2**16, 2**31, 2**32 - 1))),
        lambda: setattr(depth, "height", rng.choice((0, 1, 2**16, 2**31, 2**32 - 1))),
        lambda: setattr(depth, "step", rng.choice((0, 1, 2**31, 2**32 - 1))),
        lambda: setattr(depth, "data", bytes(rng.choice((0, 1, 1 << 20)))),
        lambda: setattr(depth, "encoding", rng.choice(NAMES).replace("\0", "")),
        lambda: setattr(pose.translation, "x", rng.choice((float("nan"), float("inf"), 1e308))),
        lambda: setattr(pose.rotation, "w", rng.choice((float("nan"), 1e200, 0.1))),
        lambda: setattr(foreign, "hand_eye", b"[" * 60_000),
        lambda: setattr(foreign, "hand_eye", json.dumps({"T_flange_camera": [[1e999] * 4] * 4}).encode()),
        lambda: foreign.metadata.update(string_radius_m=rng.choice(("1e999", "-1", "nan", "9" * 5000))),
        lambda: foreign.metadata.update({rng.choice(NAMES): rng.choice(NAMES)}),
        lambda: foreign.metadata.update(provenance="x" * 60_000),
    )
    rng.choice(numbers)()
    return foreign.bytes()


KINDS = (_flipped, _cut, _zeros, _shuffled, _doubled, _absurd, _named, _bomb, _claims)
