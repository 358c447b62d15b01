"""Content of a recording, grouped by view, for the whole file or up to a condition."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from cell.recording.errors import RecordingContentError, RecordingHeaderError, RecordingTooLargeError
from cell.recording.header import HAND_EYE, METADATA
from cell.recording.limits import Limits
from cell.recording.mcap_stream import Ending, TopicMessage, read_contents
from cell.recording.messages import (
    CALIBRATION,
    DEPTH,
    POSE,
    SCHEMAS,
    PinholeCalibration,
    decode_calibration,
    decode_colour,
    decode_depth,
    decode_pose,
)


@dataclass
class Parts:
    """Parts of one view that were found so far."""

    log_time_ns: int
    """Log time of the messages, nanoseconds since the epoch."""
    pose: NDArray[np.float64] | None = None
    """(4, 4) flange pose."""
    calibration: PinholeCalibration | None = None
    """Camera matrix and image size."""
    depth: NDArray[np.uint16] | None = None
    """Depth image (H, W), counts."""
    colour: bytes | None = None
    """Colour image, JPEG."""


@dataclass
class Contents:
    """Content of a recording that was found so far."""

    views: dict[int, Parts] = field(default_factory=dict)
    """Parts of each view, by its index."""
    not_taken: list[str] = field(default_factory=list)
    """Messages about content that was not read."""
    metadata: dict[str, str] | None = None
    """Fields of the `pointchain` metadata."""
    hand_eye: bytes | None = None
    """Content of the hand-eye attachment."""
    cut: str | None = None
    """Where the file was cut off, or None."""


def everything(_: TopicMessage) -> bool:
    """Return True: every message is read."""
    return True


def never(_: Contents) -> bool:
    """Return False: the whole file is read."""
    return False


def collect(
    path: Path,
    limits: Limits,
    wanted: Callable[[TopicMessage], bool] = everything,
    enough: Callable[[Contents], bool] = never,
) -> Contents:
    """Read the views of a file.

    Args:
        path: The MCAP file.
        limits: Sizes up to which the file is read.
        wanted: Selects the messages to read.
        enough: Ends the reading when it returns True.

    Raises:
        RecordingError: The recording cannot be used. The subclass and the message say why and where.
    """
    contents = Contents()
    for item in read_contents(path, limits):
        match item:
            case TopicMessage(topic=topic) if topic in SCHEMAS:
                if not wanted(item):
                    continue
                contents.not_taken.extend(_take(item, contents.views, limits))
            case Metadata(name=name) if name == METADATA:
                if contents.metadata is not None:
                    raise RecordingHeaderError(f"{path.name} has its {METADATA!r} metadata twice")
                contents.metadata = item.metadata
            case Attachment(name=name) if name == HAND_EYE:
                if contents.hand_eye is not None:
                    raise RecordingHeaderError(f"{path.name} has its attachment {HAND_EYE} twice")
                if len(item.data) > limits.attachment_bytes:
                    raise RecordingTooLargeError(
                        f"{HAND_EYE} has {len(item.data)} bytes; {limits.attachment_bytes} at most are read"
                    )
                contents.hand_eye = item.data
            case Ending():
                contents.cut = item.cut
        if enough(contents):
            break
    return contents


def _take(message: TopicMessage, views: dict[int, Parts], limits: Limits) -> Iterator[str]:
    """Add a message to its view, and yield a message about content that is not read."""
    topic, index = message.topic, message.sequence
    where = f"view {index}"
    wanted = SCHEMAS[topic].DESCRIPTOR.full_name
    if (message.encoding, message.schema) != ("protobuf", wanted):
        raise RecordingContentError(
            f"{topic} has messages of type {message.schema[:60]!r} in encoding {message.encoding[:20]!r}; "
            f"only {wanted!r} in encoding 'protobuf' is read"
        )
    if topic in (POSE, CALIBRATION) and len(message.data) > limits.metadata_bytes:
        raise RecordingTooLargeError(
            f"{where}: {topic} has {len(message.data)} bytes; {limits.metadata_bytes} at most are read"
        )
    part: Any
    if topic == POSE:
        part, name = decode_pose(message.data, where), "pose"
        if part is None:  # the transform of other frames
            return
    elif topic == CALIBRATION:
        part, name = decode_calibration(message.data, where), "calibration"
    elif topic == DEPTH:
        part, name = decode_depth(message.data, where, limits.image_pixels), "depth"
    else:
        (part, kind), name = decode_colour(message.data, where), "colour"
        if kind.lower() not in ("jpeg", "jpg"):
            yield f"{where} has its colour image as {kind!r}; only jpeg is supported"
            return
    if index >= limits.views:
        raise RecordingTooLargeError(
            f"{where} ({topic}): view indices, given by `sequence`, are from 0 to {limits.views - 1}"
        )
    parts = views.setdefault(index, Parts(message.log_time_ns))
    if getattr(parts, name) is not None:
        raise RecordingContentError(f"{where} is duplicated: it has two messages on {topic}")
    if parts.log_time_ns != message.log_time_ns:
        raise RecordingContentError(
            f"{where}: its messages have different times, {parts.log_time_ns} ns and {message.log_time_ns} ns ({topic})"
        )
    setattr(parts, name, part)
