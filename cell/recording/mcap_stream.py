"""Reader of the records of an MCAP file, which checks every size before it is used.

The readers of the mcap library need the end of the file, or trust the sizes in the file. Files here may be cut off
anywhere and may come from anybody. This reader therefore walks through the records itself, and mcap only parses the
content of each record.

Source: https://mcap.dev/spec
"""

import io
import stat
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from cell.recording.errors import (
    NotMcapError,
    RecordingCorruptError,
    RecordingTooLargeError,
    RecordingUnreadableError,
)
from cell.recording.limits import Limits

_HEAD = struct.Struct("<BQ")
_DATA_END_BYTES = 4
_FOOTER_BYTES = 20


@dataclass(frozen=True)
class TopicMessage:
    """A message with the properties of its channel."""

    topic: str
    """Topic of the channel."""
    encoding: str
    """Encoding of the message."""
    schema: str
    """Name of the schema, or an empty text."""
    sequence: int
    """Sequence number, which is the index of the view."""
    log_time_ns: int
    """Log time, nanoseconds since the epoch."""
    data: bytes
    """Encoded message."""


@dataclass(frozen=True)
class Ending:
    """End of the file, which is always the last item."""

    cut: str | None
    """Where the file was cut off, or None for a complete file."""


Record = TypeVar("Record")
Item = Metadata | Attachment | TopicMessage | Ending


def read_contents(path: Path, limits: Limits) -> Iterator[Item]:
    """Yield the content of a file in its order, up to its end or to where it was cut off.

    The summary after the data is not read, because it repeats the data.

    Args:
        path: The MCAP file.
        limits: Sizes up to which the file is read.

    Raises:
        RecordingUnreadableError: There is no such regular file, or no permission.
        NotMcapError: The file is empty or of another format.
        RecordingTooLargeError: A size exceeds `limits`.
        RecordingCorruptError: The file is damaged in another way than by a missing or torn end.
    """
    try:
        # checked before opening, because opening a named pipe would wait for its writer
        regular = stat.S_ISREG(path.stat().st_mode)
        if regular:
            with path.open("rb") as file:
                yield from _Walk(limits).file_items(file, _checked_size(file, path.name, limits))
    except OSError as error:
        raise RecordingUnreadableError(f"{path.name} cannot be read: {error.strerror or error}") from error
    if not regular:
        raise RecordingUnreadableError(f"{path.name} is not a file; give one MCAP recording")


def _checked_size(file: BinaryIO, name: str, limits: Limits) -> int:
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    if size == 0:
        raise NotMcapError(f"{name} is empty; a recording starts with the magic bytes of MCAP")
    if size > limits.file_bytes:
        raise RecordingTooLargeError(f"{name} has {size} bytes; {limits.file_bytes} at most are read")
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise NotMcapError(f"{name} is not an MCAP file: it does not start with the magic bytes of MCAP")
    return size


class _Walk:
    """One pass through a file, with the channels found so far and the used part of the limits."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.records = 0
        self.content_bytes = 0
        self.schemas: dict[int, str] = {}
        self.channels: dict[int, tuple[str, str, int]] = {}

    def file_items(self, file: BinaryIO, size: int) -> Iterator[Item]:
        """Yield the items of the file after its magic bytes."""
        crc = zlib.crc32(MCAP0_MAGIC)
        while True:
            where = f"at byte {file.tell()}"
            head = file.read(_HEAD.size)
            if not head:
                yield Ending("the file has no end record")
                return
            if len(head) < _HEAD.size or head[0] == 0:
                # a crash can leave zeros at the end, and no record starts with zero
                yield Ending(f"the file ends inside the record {where}")
                return
            opcode, length = _HEAD.unpack(head)
            self._admit(opcode, length, where)
            end = file.tell() + length
            if end > size:
                yield Ending(f"the file ends inside the record {where}")
                return
            content = file.read(length)
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                _check_end(opcode, content, crc, where)
                yield Ending(None)
                return
            crc = zlib.crc32(content, zlib.crc32(head, crc))
            if opcode == Opcode.CHUNK:
                try:
                    data = self._decompressed(content, where)
                except RecordingCorruptError as error:
                    if end < size:
                        raise
                    yield Ending(f"the last record is incomplete: {error}")
                    return
                yield from self._chunk_items(data, f"in the chunk {where}")
            else:
                if opcode == Opcode.MESSAGE:
                    self._use(length)
                yield from self._item(opcode, content, where)

    def _chunk_items(self, data: bytes, where: str) -> Iterator[Item]:
        end = 0
        while end < len(data):
            start = end + _HEAD.size
            if start > len(data):
                raise RecordingCorruptError(f"a record {where} is longer than what is left of the chunk")
            opcode, length = _HEAD.unpack_from(data, end)
            self._admit(opcode, length, where)
            end = start + length
            if end > len(data):
                raise RecordingCorruptError(f"a record {where} is longer than what is left of the chunk")
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                yield from self._item(opcode, data[start:end], where)

    def _item(self, opcode: int, content: bytes, where: str) -> Iterator[Item]:
        if opcode == Opcode.SCHEMA:
            schema = _parse(Schema.read, content, where)
            self.schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel = _parse(Channel.read, content, where)
            self.channels[channel.id] = (channel.topic, channel.message_encoding, channel.schema_id)
        elif opcode == Opcode.MESSAGE:
            message = _parse(lambda stream: Message.read(stream, len(content)), content, where)
            if message.channel_id not in self.channels:
                raise RecordingCorruptError(
                    f"a message {where} is on channel {message.channel_id}, which was not declared"
                )
            topic, encoding, schema_id = self.channels[message.channel_id]
            schema = self.schemas.get(schema_id, "")
            yield TopicMessage(topic, encoding, schema, message.sequence, message.log_time, message.data)
        elif opcode == Opcode.METADATA:
            yield _parse(Metadata.read, content, where)
        elif opcode == Opcode.ATTACHMENT:
            attachment = _parse(Attachment.read, content, where)
            if content[-4:] not in (b"\0\0\0\0", zlib.crc32(content[:-4]).to_bytes(4, "little")):
                raise RecordingCorruptError(f"the attachment {where} fails its checksum")
            yield attachment

    def _decompressed(self, content: bytes, where: str) -> bytes:
        chunk = _parse(Chunk.read, content, where)
        size = chunk.uncompressed_size
        if size > self.limits.chunk_bytes:
            raise RecordingTooLargeError(
                f"the chunk {where} announces {size} bytes; {self.limits.chunk_bytes} at most are read"
            )
        self._use(size)
        try:
            data = _decompress(chunk, self.limits.chunk_bytes)
        except (zstandard.ZstdError, RuntimeError) as error:
            raise RecordingCorruptError(f"the chunk {where} does not decompress: {error}") from error
        if data is None:
            raise RecordingCorruptError(
                f"the chunk {where} is compressed by {chunk.compression[:20]!r}; zstd, lz4 or none is read"
            )
        if len(data) != size:
            raise RecordingCorruptError(f"the chunk {where} does not hold the {size} bytes that it announces")
        if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise RecordingCorruptError(f"the chunk {where} fails its checksum")
        return data

    def _admit(self, opcode: int, length: int, where: str) -> None:
        self.records += 1
        if self.records > self.limits.records:
            raise RecordingTooLargeError(f"the file has more than {self.limits.records} records")
        small = opcode in (Opcode.METADATA, Opcode.CHANNEL)
        limit = self.limits.metadata_bytes if small else self.limits.record_bytes
        if length > limit:
            raise RecordingTooLargeError(f"the record {where} announces {length} bytes; {limit} at most are read")

    def _use(self, content_bytes: int) -> None:
        self.content_bytes += content_bytes
        if self.content_bytes > self.limits.content_bytes:
            raise RecordingTooLargeError(f"the file holds more than {self.limits.content_bytes} bytes, decompressed")


class _StrictStream(ReadDataStream):
    """A stream of mcap that raises at the end of its data instead of returning fewer bytes."""

    def read(self, length: int) -> bytes:
        data = super().read(length)
        if len(data) < length:
            raise EndOfFile
        return data


def _parse(read: Callable[[ReadDataStream], Record], content: bytes, where: str) -> Record:
    try:
        return read(_StrictStream(io.BytesIO(content)))
    except EndOfFile as error:
        raise RecordingCorruptError(f"the record {where} is damaged: it is too short") from error
    except (ValueError, OverflowError) as error:  # text that is not UTF-8, a length beyond 2^63
        raise RecordingCorruptError(f"the record {where} is damaged: {error}") from error


def _decompress(chunk: Chunk, window_bytes: int) -> bytes | None:
    """Decompress a chunk up to one byte more than it announces. Return None for an unknown compression."""
    most = chunk.uncompressed_size + 1
    match chunk.compression:
        case "":
            return chunk.data
        case "zstd":
            # streamed, because in a single call the frame's header determines the memory
            decompressor = zstandard.ZstdDecompressor(max_window_size=window_bytes)
            return decompressor.stream_reader(chunk.data, read_across_frames=True).read(most)
        case "lz4":
            return lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most)
    return None


def _check_end(opcode: int, content: bytes, crc: int, where: str) -> None:
    is_data_end = opcode == Opcode.DATA_END
    if len(content) != (_DATA_END_BYTES if is_data_end else _FOOTER_BYTES):
        raise RecordingCorruptError(f"the end record {where} has {len(content)} bytes: it is damaged")
    if is_data_end and content not in (b"\0\0\0\0", crc.to_bytes(4, "little")):
        raise RecordingCorruptError("the file fails its checksum: it was changed after it had been written")
