"""A model alone as an MCAP file for viewers, as in the recording of a live scan but without views."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer

from cell.recording.mcap_channels import register_channel
from cell.recording.reader import MODEL
from cell.recording.result_scene import scene_of_model
from cell.recording.writer import SCENE


def write_result_file(path: Path, model: Mapping[str, Any]) -> None:
    """Write a new file with a model document and its scene, and sync it to the disk.

    The same model gives the same bytes. `cell.recording.read_result` reads it.

    Args:
        path: File to create.
        model: Document of schema `pointchain/2`.

    Raises:
        OSError: The file exists, or cannot be written.
    """
    document = json.dumps(dict(model), allow_nan=False).encode()
    scene = scene_of_model(model, Timestamp())
    with path.open("xb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(library="pointchain")
        for topic, message in ((MODEL, document), (SCENE, scene)):
            data = message if isinstance(message, bytes) else message.SerializeToString(deterministic=True)
            writer.add_message(register_channel(writer, topic, message), 0, data, 0)
        writer.finish()
        file.flush()
        os.fsync(file.fileno())
