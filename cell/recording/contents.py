"""Content of a recording, grouped by view, for the whole file or up to a condition."""

from collections.abc import Callable
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
    COLOUR,
    DEPTH,
    INTENSITY,
    POSE,
    SCHEMAS,
    PinholeCalibration,
    UnusableColourError,
    decode_calibration,
    decode_colour,
    decode_depth,
    decode_intensity,
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
    intensity: NDArray[np.uint8] | None = None
    """Intensity image (H, W), grey levels."""
    colour: bytes | None = None
    """Colour image, JPEG."""


@dataclass
class Contents:
    """Content of a recording that was found so far."""

    views: dict[int, Parts] = field(default_factory=dict)
    """Parts of each view, by its index."""
    unusable_colour: dict[int, str] = field(default_factory=dict)
    """Why the colour image of a view cannot be used, by the index of the view."""
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
                _take(item, contents, limits)
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


def _take(message: TopicMessage, contents: Contents, limits: Limits) -> None:
    """Add a message to its view."""
    topic, index = message.topic, message.sequence
    where = f"view {index}"
    try:
        part, name = _decode(message, where, limits)
    except UnusableColourError as error:
        if index < limits.views:
            contents.unusable_colour.setdefault(index, str(error))
        return
    if part is None:  # the transform of other frames
        return
    if index >= limits.views:
        raise RecordingTooLargeError(
            f"{where} ({topic}): view indices, given by `sequence`, are from 0 to {limits.views - 1}"
        )
    parts = contents.views.setdefault(index, Parts(message.log_time_ns))
    if getattr(parts, name) is not None:
        raise RecordingContentError(f"{where} is duplicated: it has two messages on {topic}")
    if parts.log_time_ns != message.log_time_ns:
        raise RecordingContentError(
            f"{where}: its messages have different times, {parts.log_time_ns} ns and {message.log_time_ns} ns ({topic})"
        )
    setattr(parts, name, part)


def _decode(message: TopicMessage, where: str, limits: Limits) -> tuple[Any, str]:
    """Return the part of a view in a message, and its name in `Parts`. None: it is no part of a view."""
    topic, wanted = message.topic, SCHEMAS[message.topic].DESCRIPTOR.full_name
    if (message.encoding, message.schema) != ("protobuf", wanted):
        what = f"of type {message.schema[:60]!r} in encoding {message.encoding[:20]!r}"
        if topic == COLOUR:
            raise UnusableColourError(f"is {what}; only {wanted!r} in encoding 'protobuf' is read")
        raise RecordingContentError(f"{topic} has messages {what}; only {wanted!r} in encoding 'protobuf' is read")
    if topic in (POSE, CALIBRATION) and len(message.data) > limits.metadata_bytes:
        raise RecordingTooLargeError(
            f"{where}: {topic} has {len(message.data)} bytes; {limits.metadata_bytes} at most are read"
        )
    if topic == POSE:
        return decode_pose(message.data, where), "pose"
    if topic == CALIBRATION:
        return decode_calibration(message.data, where), "calibration"
    if topic == DEPTH:
        return decode_depth(message.data, where, limits.image_pixels), "depth"
    if topic == INTENSITY:
        return decode_intensity(message.data, where, limits.image_pixels), "intensity"
    return decode_colour(message.data, limits.colour_pixels), "colour"
