"""Recordings: one MCAP file per scan, with Foxglove's messages, written view by view.

A view is on the disk when `write_view` returns, so a process that is killed afterwards does not lose it. Reading
accepts complete, unfinished and truncated files, returns every complete view, and says what is missing.
"""

import json
import os
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

from calibration.atomic_write import sync_folder
from cell.devices import View
from cell.recording.errors import (
    RecordingContentError,
    RecordingError,
    RecordingExistsError,
    RecordingTooLargeError,
)
from cell.recording.hashed_file import HashedFile, WrittenRange
from cell.recording.header import HAND_EYE, METADATA, RecordingHeader, to_hand_eye, to_metadata
from cell.recording.limits import DEFAULT_LIMITS, MIB
from cell.recording.mcap_channels import register_channel
from cell.recording.messages import POSE, decode_pose, encode_view
from cell.recording.reader import MODEL
from cell.recording.result_scene import scene_of_model

SCENE = "/result/scene"


class RecordingWriter:
    """Write a recording, view by view. Use it as a context manager.

    The same header, views and model give the same bytes: the file holds nothing of the clock or the machine. If the
    context ends by an exception, the file has no end record, and reading reports that it was cut off.

    Example:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> import numpy as np
        >>> from calibration.geometry import from_rotation_vector
        >>> from cell.recording import read_recording
        >>> T_flange_camera = from_rotation_vector((0.0, 0.0, 0.05), (0.0, 0.0, 0.0))
        >>> header = RecordingHeader(depth_unit_m=0.001, string_radius_m=0.0042, T_flange_camera=T_flange_camera)
        >>> view = View(
        ...     index=0,
        ...     depth=np.full((400, 640), 500, dtype=np.uint16),
        ...     depth_unit_m=0.001,
        ...     K=np.array([[400.0, 0.0, 319.5], [0.0, 400.0, 199.5], [0.0, 0.0, 1.0]]),
        ...     T_base_flange=from_rotation_vector((0.4, 0.0, 0.55), (np.pi, 0.0, 0.0)),
        ...     T_flange_camera=T_flange_camera,
        ... )
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder) / "table.mcap"
        ...     with RecordingWriter(path, header) as writer:
        ...         written = writer.write_view(view)
        ...     recording = read_recording(path)
        >>> len(recording.views), recording.header.string_radius_m, recording.missing
        (1, 0.0042, ())
    """

    def __init__(self, path: str | os.PathLike[str], header: RecordingHeader) -> None:
        """Create the file with the metadata and the hand-eye calibration, and sync it to the disk.

        Args:
            path: File to create.
            header: The values that hold for all views.

        Raises:
            RecordingExistsError: The file exists; recordings are never overwritten.
            OSError: The file cannot be created or written. No file is left behind.
        """
        path = Path(path)
        self._path, self._header = path, header
        self._channels: dict[str, int] = {}
        self._written: dict[int, WrittenRange] = {}
        """Range of bytes of each view, by its index."""
        self._content_bytes = 0
        self._log_time_ns = 0
        self._failed = False
        try:
            self._file = HashedFile(path)
        except FileExistsError as error:
            raise RecordingExistsError(f"{path.name} exists; recordings are never overwritten") from error
        # the checksum over all data shows a later change of a finished recording;
        # the writer calls only `write`, `tell` and `flush`
        self._writer = Writer(cast(IO[bytes], self._file), compression=CompressionType.ZSTD, enable_data_crcs=True)
        try:
            self._writer.start(library="pointchain")
            self._writer.add_metadata(METADATA, to_metadata(header))
            self._writer.add_attachment(0, 0, HAND_EYE, "application/json", to_hand_eye(header))
            self._writer.flush()
            self._file.sync()
            sync_folder(path.parent)
        except BaseException:
            self._file.abandon()
            path.unlink()
            raise

    def write_view(self, view: View) -> View:
        """Write one view as a chunk. It is on the disk when this returns.

        Args:
            view: The view. Its depth unit and hand-eye calibration are those of the header.

        Returns:
            The view as a reader will get it. Its pose has passed through a quaternion, so recognition gives the same
            result from this view and from the file, to the last bit.

        Raises:
            RecordingError: A view with this index is in the file, the view is too large, or its depth unit or hand-eye
                calibration differs from the header. The file is unchanged.
            OSError: The disk is full or fails. The file keeps the earlier views and takes no more.
        """
        where = f"view {view.index}"
        self._check_open()
        if view.index in self._written:
            raise RecordingContentError(f"{where} is already in the recording")
        if not 0 <= view.index < DEFAULT_LIMITS.views:
            raise RecordingTooLargeError(f"{where}: view indices are from 0 to {DEFAULT_LIMITS.views - 1}")
        if view.depth.size > DEFAULT_LIMITS.image_pixels:
            raise RecordingTooLargeError(
                f"{where}: {view.depth.size} pixels of depth; at most {DEFAULT_LIMITS.image_pixels} are allowed"
            )
        if view.depth_unit_m != self._header.depth_unit_m:
            raise RecordingContentError(
                f"{where}: its depth unit is {view.depth_unit_m:g} m, that of the recording "
                f"{self._header.depth_unit_m:g} m"
            )
        if not np.array_equal(view.T_flange_camera, self._header.T_flange_camera):
            raise RecordingContentError(f"{where}: its T_flange_camera differs from that of the recording")
        log_time_ns = _nanoseconds(view.stamp_s, where)
        messages = encode_view(view, log_time_ns)
        content_bytes = sum(message.ByteSize() for _, message in messages)
        self._check_size(where, content_bytes)
        with self._writing():
            for topic, message in messages:
                self._add(topic, message, log_time_ns, sequence=view.index)
            self._writer.flush()  # ends the chunk
            self._written[view.index] = self._file.sync()
        self._content_bytes += content_bytes
        self._log_time_ns = max(self._log_time_ns, log_time_ns)
        T_base_flange = decode_pose(dict(messages)[POSE].SerializeToString(), where)
        assert T_base_flange is not None
        return replace(view, T_base_flange=T_base_flange)

    def written(self, index: int) -> WrittenRange:
        """Return the range of bytes that a view added to the file.

        Args:
            index: Index of the view.

        Raises:
            KeyError: The view was not written.
        """
        return self._written[index]

    def write_result(self, model: Mapping[str, Any]) -> None:
        """Write a model as `/result/model`, and as a scene for viewers.

        Args:
            model: Document of schema `pointchain/2`, as `PointChainModel.to_json` returns it.

        Raises:
            RecordingContentError: The model holds NaN, infinity, or a value that JSON does not have.
            RecordingTooLargeError: The model is too large.
            OSError: As for `write_view`.
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
            self._writer.flush()
            self._file.sync()
        self._content_bytes += content_bytes

    def close(self) -> None:
        """End the recording with index and end record, and sync it. A second call does nothing.

        Raises:
            OSError: As for `write_view`. The file is closed anyway.
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
        # after a failed write the file may end inside a record, after which nothing can be read
        try:
            yield
        except BaseException:
            self._failed = True
            raise

    def _check_open(self) -> None:
        if self._failed or self._file.closed:
            raise RecordingError(
                f"{self._path.name} cannot be written any more: it was closed, or an earlier write failed"
            )

    def _check_size(self, where: str, content_bytes: int) -> None:
        # half a chunk, and 1 MiB in all, are reserved for schemas, channels and record heads
        if content_bytes > DEFAULT_LIMITS.chunk_bytes // 2:
            raise RecordingTooLargeError(
                f"{where} has {content_bytes} bytes; at most {DEFAULT_LIMITS.chunk_bytes // 2} are allowed"
            )
        if self._content_bytes + content_bytes > DEFAULT_LIMITS.content_bytes - MIB:
            raise RecordingTooLargeError(f"{where}: the recording is full, it holds {self._content_bytes} bytes")


def _nanoseconds(stamp_s: float, where: str) -> int:
    # exact, because a float times 1e9 would be rounded to 256 ns; the reader divides and gets the same float
    if not (np.isfinite(stamp_s) and 0 <= stamp_s < 2**33):
        raise RecordingContentError(f"{where}: stamp {stamp_s!r} s; it must be seconds since the epoch")
    return round(Fraction(float(stamp_s)) * 1_000_000_000)


def _timestamp(nanoseconds: int) -> Timestamp:
    stamp = Timestamp()
    stamp.FromNanoseconds(nanoseconds)
    return stamp
