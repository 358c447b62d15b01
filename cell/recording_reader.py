"""From an MCAP file to views: the complete ones in order, and what is missing in words."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from mcap.records import Attachment, Metadata
from numpy.typing import NDArray

from calibration.transforms import NotRigidError
from cell.devices import InvalidViewError, View
from cell.mcap_stream import Ending, TopicMessage, read_contents
from cell.recording_errors import (
    RecordingContentError,
    RecordingEmptyError,
    RecordingHeaderError,
    RecordingTooLargeError,
)
from cell.recording_header import HAND_EYE, METADATA, RecordingHeader, parse_header
from cell.recording_limits import DEFAULT_LIMITS, Limits
from cell.view_messages import (
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

MODEL = "/result/model"


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording that was read."""

    header: RecordingHeader
    views: tuple[View, ...]
    """The complete views in the order of their indices; one at least."""
    missing: tuple[str, ...]
    """What is missing, in words; empty when the recording is whole."""


@dataclass
class _Parts:
    """What was met of one view so far."""

    log_time_ns: int
    pose: NDArray[np.float64] | None = None
    calibration: PinholeCalibration | None = None
    depth: NDArray[np.uint16] | None = None
    colour: bytes | None = None


@dataclass
class _Contents:
    """What was met of a recording so far."""

    views: dict[int, _Parts] = field(default_factory=dict)
    not_taken: list[str] = field(default_factory=list)
    metadata: dict[str, str] | None = None
    hand_eye: bytes | None = None
    cut: str | None = None


def read_recording(path: Path, limits: Limits = DEFAULT_LIMITS) -> Recording:
    """All complete views of a recording, ours or another writer's, in the order in which they were taken.

    A view that lacks its pose, calibration or depth image is left out and told in `missing`, and so is an end
    that was cut off. A view whose content is wrong refuses the whole recording: it is not to be trusted.

    Raises:
        RecordingError: the recording cannot be used; the subclass and the message say why and where.
    """
    contents = _collect(path, limits)
    header = _header(contents, path.name)
    complete: list[View] = []
    missing = contents.not_taken
    for index in range(max(contents.views, default=-1) + 1):
        parts = contents.views.get(index)
        view = _view(index, parts, header)
        if view is None:
            missing.append(f"view {index} {_lacking(parts)}")
        else:
            complete.append(view)
    # In the order in which they were taken: recognition of a replay then does what it did while the arm moved.
    complete.sort(key=lambda view: view.stamp_s)
    if not complete:
        raise RecordingEmptyError(f"{path.name} has no complete view: {_why_none(contents)}")
    if contents.cut:
        missing.append(f"{contents.cut}; whatever followed view {complete[-1].index}, the last one taken, is lost")
    return Recording(header, tuple(complete), tuple(missing))


def read_result(path: Path, limits: Limits = DEFAULT_LIMITS) -> dict[str, Any] | None:
    """The model document that was stored last in a recording; None when there is none.

    Raises:
        RecordingError: as for `read_recording`, or what is stored is not a JSON object.
    """
    last = None
    for item in read_contents(path, limits):
        if isinstance(item, TopicMessage) and item.topic == MODEL:
            last = item.data
    if last is None:
        return None
    try:
        model = json.loads(last, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise RecordingContentError(f"{MODEL} in {path.name} is not JSON: {error}") from error
    if not isinstance(model, dict):
        raise RecordingContentError(f"{MODEL} in {path.name} is a {type(model).__name__}; a JSON object is needed")
    return model


def _collect(path: Path, limits: Limits) -> _Contents:
    contents = _Contents()
    for item in read_contents(path, limits):
        match item:
            case TopicMessage(topic=topic) if topic in SCHEMAS:
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
    return contents


def _header(contents: _Contents, name: str) -> RecordingHeader:
    cut = f" ({contents.cut})" if contents.cut else ""
    if contents.metadata is None:
        raise RecordingHeaderError(f"{name} has no {METADATA!r} metadata{cut}: it is no recording of a scan")
    if contents.hand_eye is None:
        raise RecordingHeaderError(f"{name} has no attachment {HAND_EYE}{cut}: where the camera was is not known")
    return parse_header(contents.metadata, contents.hand_eye)


def _take(message: TopicMessage, views: dict[int, _Parts], limits: Limits) -> Iterator[str]:
    """Puts a message to the view it belongs to; yields, in words, what of it is not taken."""
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
        if part is None:  # another edge of the frame tree
            return
    elif topic == CALIBRATION:
        part, name = decode_calibration(message.data, where), "calibration"
    elif topic == DEPTH:
        part, name = decode_depth(message.data, where, limits.image_pixels), "depth"
    else:
        (part, kind), name = decode_colour(message.data, where), "colour"
        if kind.lower() not in ("jpeg", "jpg"):
            yield f"{where} has its colour image as {kind!r}; only jpeg is taken"
            return
    if index >= limits.views:
        raise RecordingTooLargeError(f"{where} ({topic}): views, told by `sequence`, go from 0 to {limits.views - 1}")
    parts = views.setdefault(index, _Parts(message.log_time_ns))
    if getattr(parts, name) is not None:
        raise RecordingContentError(f"{where} is there twice: it has two messages on {topic}")
    if parts.log_time_ns != message.log_time_ns:
        raise RecordingContentError(
            f"{where}: its messages are of different moments, {parts.log_time_ns} ns "
            f"and {message.log_time_ns} ns ({topic})"
        )
    setattr(parts, name, part)


def _lacking(parts: _Parts | None) -> str:
    """What an incomplete view lacks, in words."""
    if parts is None:
        return "is not in the file"
    needed = {
        f"pose ({POSE}, base to flange)": parts.pose,
        f"calibration ({CALIBRATION})": parts.calibration,
        f"depth image ({DEPTH})": parts.depth,
    }
    return "has " + ", ".join(f"no {name}" for name, part in needed.items() if part is None)


def _view(index: int, parts: _Parts | None, header: RecordingHeader) -> View | None:
    """The view, or None when a part is missing."""
    if parts is None or parts.pose is None or parts.calibration is None or parts.depth is None:
        return None
    height, width = parts.depth.shape
    calibration = parts.calibration
    if (calibration.width, calibration.height) != (width, height):
        raise RecordingContentError(
            f"view {index}: the calibration is of {calibration.width}x{calibration.height} pixels, "
            f"the depth image of {width}x{height}"
        )
    try:
        return View(
            index=index,
            depth=parts.depth,
            depth_unit_m=header.depth_unit_m,
            K=calibration.K,
            T_base_flange=parts.pose,
            T_flange_camera=header.T_flange_camera,
            stamp_s=parts.log_time_ns / 1_000_000_000,
            colour_jpeg=parts.colour,
        )
    except (InvalidViewError, NotRigidError) as error:
        raise RecordingContentError(str(error)) from error


def _why_none(contents: _Contents) -> str:
    by_reason: dict[str, list[str]] = {}
    for index in sorted(contents.views):
        by_reason.setdefault(_lacking(contents.views[index]), []).append(str(index))
    reasons = [f"view {', '.join(indices)} {reason}" for reason, indices in by_reason.items()]
    reasons = reasons or ["it has no message of any view"]
    return "; ".join([*reasons, contents.cut] if contents.cut else reasons)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"it holds {name}")
