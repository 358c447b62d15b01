"""Recordings: one MCAP file a scan, with Foxglove's messages, written view by view.

A view is on disk when `write_view` returns: a process that is killed afterwards loses nothing of it. Reading
takes whole, unfinished and cut off files, uses every complete view, and says what is missing.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, cast

import numpy as np
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer

from calibration.disk import sync_folder
from cell.devices import View
from cell.hashed_file import HashedFile, Written
from cell.mcap_channels import register_channel
from cell.recording_errors import (
    NotMcapError,
    RecordingContentError,
    RecordingCorruptError,
    RecordingEmptyError,
    RecordingError,
    RecordingExistsError,
    RecordingHeaderError,
    RecordingTooLargeError,
    RecordingUnreadableError,
)
from cell.recording_header import HAND_EYE, METADATA, RecordingHeader, to_hand_eye, to_metadata
from cell.recording_limits import DEFAULT_LIMITS, MIB, Limits
from cell.recording_reader import MODEL, Recording, read_recording, read_result
from cell.result_scene import scene_of_model
from cell.view_messages import POSE, decode_pose, encode_view

SCENE = "/result/scene"


class RecordingWriter:
    """Writes a recording; use as a context manager.

    Nothing of the clock or the machine goes into the file: the same header, views and model give the same
    bytes. Left by an exception, the file stays without an end record: it says itself that it was cut off.
    """

    def __init__(self, path: Path, header: RecordingHeader) -> None:
        """Creates the file with the metadata and the hand-eye calibration, and syncs it to disk.

        Raises:
            RecordingExistsError: the file is there; recordings are never overwritten.
            OSError: the file cannot be created or written. None is left behind.
        """
        self._path, self._header = path, header
        self._channels: dict[str, int] = {}
        self._written: dict[int, Written] = {}
        """Of each view, by its index."""
        self._content_bytes = 0
        self._log_time_ns = 0
        self._failed = False
        try:
            self._file = HashedFile(path)
        except FileExistsError as error:
            raise RecordingExistsError(f"{path.name} exists; recordings are never overwritten") from error
        # The checksum over all data is what tells that a finished recording was changed afterwards.
        # The writer writes, tells and flushes, and nothing else.
        self._writer = Writer(cast(IO[bytes], self._file), compression=CompressionType.ZSTD, enable_data_crcs=True)
        try:
            self._writer.start(library="pointchain")
            self._writer.add_metadata(METADATA, to_metadata(header))
            self._writer.add_attachment(0, 0, HAND_EYE, "application/json", to_hand_eye(header))
            self._sync()
            sync_folder(path.parent)
        except BaseException:
            self._file.abandon()
            path.unlink()
            raise

    def write_view(self, view: View) -> View:
        """Writes one view as a chunk of its own; it is on disk when this returns.

        Returns the view as a reader will get it: its pose has passed through a quaternion, so that recognition gives
        the same from either, to the last bit.

        Raises:
            RecordingError: there already, larger than what is read, or of another depth unit or hand-eye
                calibration than the header's. The file is as before.
            OSError: the disk is full or fails. The file keeps the earlier views and takes no more.
        """
        where = f"view {view.index}"
        self._check_open()
        if view.index in self._written:
            raise RecordingContentError(f"{where} is in the recording already")
        if not 0 <= view.index < DEFAULT_LIMITS.views:
            raise RecordingTooLargeError(f"{where}: views go from 0 to {DEFAULT_LIMITS.views - 1}")
        if view.depth.size > DEFAULT_LIMITS.image_pixels:
            raise RecordingTooLargeError(
                f"{where}: {view.depth.size} pixels of depth; {DEFAULT_LIMITS.image_pixels} at most are taken"
            )
        if view.depth_unit_m != self._header.depth_unit_m:
            raise RecordingContentError(
                f"{where}: its depth unit is {view.depth_unit_m:g} m, the recording's {self._header.depth_unit_m:g} m"
            )
        if not np.array_equal(view.T_flange_camera, self._header.T_flange_camera):
            raise RecordingContentError(f"{where}: its T_flange_camera is not the recording's")
        log_time_ns = _nanoseconds(view.stamp_s, where)
        messages = encode_view(view, log_time_ns)
        content_bytes = sum(message.ByteSize() for _, message in messages)
        self._check_size(where, content_bytes)
        with self._writing():
            for topic, message in messages:
                self._add(topic, message, log_time_ns, sequence=view.index)
            self._written[view.index] = self._sync()
        self._content_bytes += content_bytes
        self._log_time_ns = max(self._log_time_ns, log_time_ns)
        T_base_flange = decode_pose(dict(messages)[POSE].SerializeToString(), where)
        assert T_base_flange is not None
        return replace(view, T_base_flange=T_base_flange)

    def written(self, index: int) -> Written:
        """The bytes that a view added to the file. Raises KeyError: it was not written."""
        return self._written[index]

    def write_result(self, model: Mapping[str, Any]) -> None:
        """Writes a model document (schema `pointchain/1`) as `/result/model`, and as a scene for viewers.

        Raises:
            RecordingContentError: the model holds NaN or infinity, or what JSON cannot.
            RecordingTooLargeError: it is larger than what is read.
            OSError: as for `write_view`.
        """
        self._check_open()
        try:
            document = json.dumps(dict(model), allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise RecordingContentError(f"the model cannot be written as JSON: {error}") from error
        scene = scene_of_model(model, _timestamp(self._log_time_ns))
        content_bytes = len(document) + scene.ByteSize()
        self._check_size("the model", content_bytes)
        with self._writing():
            self._add(MODEL, document, self._log_time_ns)
            self._add(SCENE, scene, self._log_time_ns)
            self._sync()
        self._content_bytes += content_bytes

    def close(self) -> None:
        """Ends the recording: index and end record, synced. Harmless when closed already.

        Raises:
            OSError: as for `write_view`; the file is closed all the same.
        """
        try:
            if not (self._failed or self._file.closed):
                with self._writing():
                    self._writer.finish()
                    self._file.sync()
        finally:
            self._file.abandon()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._failed = True
        self.close()

    def _add(self, topic: str, message: Any, log_time_ns: int, sequence: int = 0) -> None:
        data = message if isinstance(message, bytes) else message.SerializeToString(deterministic=True)
        if topic not in self._channels:
            self._channels[topic] = register_channel(self._writer, topic, message)
        self._writer.add_message(self._channels[topic], log_time_ns, data, log_time_ns, sequence)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        # After a failed write the file may end inside a record: whatever came behind it could not be read.
        try:
            yield
        except BaseException:
            self._failed = True
            raise

    def _check_open(self) -> None:
        if self._failed or self._file.closed:
            raise RecordingError(f"{self._path.name} takes no more: it was closed, or an earlier write failed")

    def _check_size(self, where: str, content_bytes: int) -> None:
        # Half a chunk, and a mebibyte in all, are left for what is added: schemas, channels, record heads.
        if content_bytes > DEFAULT_LIMITS.chunk_bytes // 2:
            raise RecordingTooLargeError(
                f"{where} has {content_bytes} bytes; {DEFAULT_LIMITS.chunk_bytes // 2} at most are taken"
            )
        if self._content_bytes + content_bytes > DEFAULT_LIMITS.content_bytes - MIB:
            raise RecordingTooLargeError(f"{where}: the recording is full, it holds {self._content_bytes} bytes")

    def _sync(self) -> Written:
        """Ends the chunk; what was added since the last one."""
        self._writer.flush()
        return self._file.sync()


def _nanoseconds(stamp_s: float, where: str) -> int:
    # Exact, since a float times 1e9 would be rounded to 256 ns; reading divides and gets the same float back.
    if not (np.isfinite(stamp_s) and 0 <= stamp_s < 2**33):
        raise RecordingContentError(f"{where}: stamp {stamp_s!r} s; seconds since the epoch are needed")
    return round(Fraction(float(stamp_s)) * 1_000_000_000)


def _timestamp(nanoseconds: int) -> Timestamp:
    stamp = Timestamp()
    stamp.FromNanoseconds(nanoseconds)
    return stamp


__all__ = [
    "Limits",
    "NotMcapError",
    "Recording",
    "RecordingContentError",
    "RecordingCorruptError",
    "RecordingEmptyError",
    "RecordingError",
    "RecordingExistsError",
    "RecordingHeader",
    "RecordingHeaderError",
    "RecordingTooLargeError",
    "RecordingUnreadableError",
    "RecordingWriter",
    "read_recording",
    "read_result",
]
