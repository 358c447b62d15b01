"""Recordings that were damaged by chance or made to do harm."""

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
"""Of attachments; and of all that has a name."""


def records(content: bytes) -> list[bytes]:
    """The outer ones of a recording, each with its head."""
    found, at = [], len(MCAP0_MAGIC)
    while at + 9 <= len(content) - len(MCAP0_MAGIC):
        size = 9 + struct.unpack_from("<Q", content, at + 1)[0]
        found.append(content[at : at + size])
        at += size
    return found


def hostile(content: bytes, number: int) -> tuple[str, bytes]:
    """One made of the good recording `content`; the same for each number. Its kind, and what it is."""
    chance = random.Random(number)
    kind = KINDS[number % len(KINDS)]
    return f"{kind.__name__.strip('_')} {number}", kind(content, chance)


def _flipped(content: bytes, chance: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(chance.choice((1, 1, 5, 200))):
        changed[chance.randrange(8, len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)


def _cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randrange(len(content))]


def _zeros(content: bytes, chance: random.Random) -> bytes:
    begin = chance.randrange(8, len(content))
    return content[:begin] + bytes(min(chance.randrange(1, 50_000), len(content) - begin)) + content[begin + 50_000 :]


def _shuffled(content: bytes, chance: random.Random) -> bytes:
    parts = records(content)
    one, other = chance.randrange(len(parts)), chance.randrange(len(parts))
    parts[one], parts[other] = parts[other], parts[one]
    return MCAP0_MAGIC + b"".join(parts) + MCAP0_MAGIC


def _doubled(content: bytes, chance: random.Random) -> bytes:
    parts = records(content)
    one = chance.randrange(len(parts))
    return MCAP0_MAGIC + b"".join(parts[:one] + [parts[one]] * chance.choice((2, 3, 1000)) + parts[one:])[: 8 << 20]


def _absurd(content: bytes, chance: random.Random) -> bytes:
    """A record that says to have another size, or something in it."""
    parts = records(content)
    one = chance.randrange(len(parts))
    part = bytearray(parts[one])
    at = 1 if chance.random() < 0.5 else chance.randrange(9, max(10, min(len(part) - 8, 200)))
    struct.pack_into("<Q", part := part + bytes(8), at, chance.choice(ABSURD))
    parts[one] = bytes(part[:-8])
    return MCAP0_MAGIC + b"".join(parts) + MCAP0_MAGIC


def _named(content: bytes, chance: random.Random) -> bytes:
    """Attachments with names that lead elsewhere."""
    builder = RecordBuilder()
    for name in chance.sample(NAMES, 4):
        Attachment(0, 0, name, "application/json", b"evil").write(builder)
    return MCAP0_MAGIC + builder.end() + content[8:]


def _bomb(content: bytes, chance: random.Random) -> bytes:
    """A chunk that grows beyond all measure, or holds another that does."""
    grown = zstandard.compress(bytes(chance.choice((33, 200)) << 20), level=1)
    for _ in range(chance.randrange(3)):
        inner = RecordBuilder()
        Chunk("zstd", grown, 0, 0, 0, chance.choice(ABSURD)).write(inner)
        grown = zstandard.compress(inner.end())
    builder = RecordBuilder()
    Chunk(chance.choice(("zstd", "lz4", "", "evil")), grown, 0, 0, 0, chance.choice(ABSURD)).write(builder)
    return MCAP0_MAGIC + builder.end() + content[8:]


def _claims(content: bytes, chance: random.Random) -> bytes:
    """Whole, but with messages that announce what is not there."""
    foreign = Foreign()
    depth, pose = foreign.find(1, "/camera/depth"), foreign.find(1, "/tf")
    numbers: tuple[Callable[[], None], ...] = (
        lambda: setattr(depth, "width", chance.choice((0, 1, 2**16, 2**31, 2**32 - 1))),
        lambda: setattr(depth, "height", chance.choice((0, 1, 2**16, 2**31, 2**32 - 1))),
        lambda: setattr(depth, "step", chance.choice((0, 1, 2**31, 2**32 - 1))),
        lambda: setattr(depth, "data", bytes(chance.choice((0, 1, 1 << 20)))),
        lambda: setattr(depth, "encoding", chance.choice(NAMES).replace("\0", "")),
        lambda: setattr(pose.translation, "x", chance.choice((float("nan"), float("inf"), 1e308))),
        lambda: setattr(pose.rotation, "w", chance.choice((float("nan"), 1e200, 0.1))),
        lambda: setattr(foreign, "hand_eye", b"[" * 60_000),
        lambda: setattr(foreign, "hand_eye", json.dumps({"T_flange_camera": [[1e999] * 4] * 4}).encode()),
        lambda: foreign.metadata.update(string_radius_m=chance.choice(("1e999", "-1", "nan", "9" * 5000))),
        lambda: foreign.metadata.update({chance.choice(NAMES): chance.choice(NAMES)}),
        lambda: foreign.metadata.update(provenance="x" * 60_000),
    )
    chance.choice(numbers)()
    return foreign.bytes()


KINDS = (_flipped, _cut, _zeros, _shuffled, _doubled, _absurd, _named, _bomb, _claims)
