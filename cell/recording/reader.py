"""Read the views of an MCAP file: the complete ones in order, and messages about what is missing."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from calibration.geometry.transforms import NotRigidError
from cell.devices import InvalidViewError, View
from cell.recording.contents import Contents, Parts, collect
from cell.recording.errors import (
    RecordingContentError,
    RecordingEmptyError,
    RecordingHeaderError,
)
from cell.recording.header import HAND_EYE, METADATA, RecordingHeader, parse_header
from cell.recording.limits import DEFAULT_LIMITS, Limits
from cell.recording.mcap_stream import TopicMessage, read_contents
from cell.recording.messages import (
    CALIBRATION,
    DEPTH,
    POSE,
)

MODEL = "/result/model"


@dataclass(frozen=True, eq=False)
class Recording:
    """The content of a recording."""

    header: RecordingHeader
    """The values that hold for all views."""
    views: tuple[View, ...]
    """The complete views, at least one, in the order in which they were taken."""
    missing: tuple[str, ...]
    """Messages about what is missing; empty if the recording is complete."""
    unusable_colour: tuple[str, ...] = ()
    """Messages about colour images that cannot be used. Their views are complete without them."""


def read_recording(path: str | os.PathLike[str], limits: Limits = DEFAULT_LIMITS) -> Recording:
    """Read all complete views of a recording, of ours or of another writer.

    A view without pose, calibration or depth image is excluded and named in `missing`. `missing` also says if the file
    was cut off. A view with wrong content makes the whole recording refused, also if its intensity image does not fit
    its depth image. Only a colour image is optional, because recognition does not need it: one that cannot be used is
    left out, and named in `unusable_colour`.

    Args:
        path: The MCAP file.
        limits: Sizes up to which the file is read.

    Returns:
        The header and the views, in the order in which they were taken.

    Raises:
        RecordingError: The recording cannot be used. The subclass and the message say why and where.
    """
    path = Path(path)
    contents = collect(path, limits)
    header = header_of(contents, path.name)
    complete: list[View] = []
    missing: list[str] = []
    for index in range(max(contents.views, default=-1) + 1):
        parts = contents.views.get(index)
        if parts is None and header.views_as_needed:
            continue
        view = view_of(index, parts, header)
        if view is None:
            missing.append(f"view {index} {_lacking(parts)}")
        else:
            complete.append(view)
    # in the order of capture, so that recognition of a replay gives the same result as in the live scan
    complete.sort(key=lambda view: view.stamp_s)
    if not complete:
        raise RecordingEmptyError(f"{path.name} has no complete view: {_why_none(contents)}")
    if contents.cut:
        count = "1 complete view" if len(complete) == 1 else f"{len(complete)} complete views"
        missing.append(
            f"the recording is cut off: it has {count}, and anything after view {complete[-1].index} is lost; "
            f"scan again, or copy the file again if its copy is incomplete ({contents.cut})"
        )
    return Recording(header, tuple(complete), tuple(missing), tuple(_unusable_colour(contents)))


def read_result(path: str | os.PathLike[str], limits: Limits = DEFAULT_LIMITS) -> dict[str, Any] | None:
    """Read the model document that was stored last in a recording.

    Args:
        path: The MCAP file.
        limits: Sizes up to which the file is read.

    Returns:
        The document, or None if the recording has none.

    Raises:
        RecordingError: As for `read_recording`, or the stored document is not a JSON object.
    """
    path = Path(path)
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


def header_of(contents: Contents, name: str) -> RecordingHeader:
    """Return the header of the file `name`. Raise RecordingHeaderError if a part is missing or not valid."""
    cut = f" ({contents.cut})" if contents.cut else ""
    if contents.metadata is None:
        raise RecordingHeaderError(f"{name} has no {METADATA!r} metadata{cut}: it is not a recording of a scan")
    if contents.hand_eye is None:
        raise RecordingHeaderError(f"{name} has no attachment {HAND_EYE}{cut}: the pose of the camera is unknown")
    return parse_header(contents.metadata, contents.hand_eye)


def _lacking(parts: Parts | None) -> str:
    """Return what an incomplete view lacks, for a message."""
    if parts is None:
        return "is not in the file"
    needed = {
        f"pose ({POSE}, base to flange)": parts.pose,
        f"calibration ({CALIBRATION})": parts.calibration,
        f"depth image ({DEPTH})": parts.depth,
    }
    return "has " + ", ".join(f"no {name}" for name, part in needed.items() if part is None)


def view_of(index: int, parts: Parts | None, header: RecordingHeader) -> View | None:
    """Return the view, or None if a part is missing. Raise RecordingContentError if the parts do not fit together."""
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
            intensity=parts.intensity,
        )
    except (InvalidViewError, NotRigidError) as error:
        raise RecordingContentError(str(error)) from error


def _why_none(contents: Contents) -> str:
    lacking = _by_reason({index: _lacking(parts) for index, parts in contents.views.items()})
    reasons = [f"view {', '.join(indices)} {reason}" for reason, indices in lacking.items()]
    reasons = reasons or ["it has no message of any view"]
    if contents.cut:
        reasons.append(f"the recording is cut off, copy the file again, or scan again ({contents.cut})")
    return "; ".join(reasons)


def _unusable_colour(contents: Contents) -> list[str]:
    return [
        f"view{'s' if len(indices) > 1 else ''} {', '.join(indices)}: the colour image {reason}, so it is left out"
        for reason, indices in _by_reason(contents.unusable_colour).items()
    ]


def _by_reason(reasons: dict[int, str]) -> dict[str, list[str]]:
    """Return the views that each reason holds for."""
    by_reason: dict[str, list[str]] = {}
    for index in sorted(reasons):
        by_reason.setdefault(reasons[index], []).append(str(index))
    return by_reason


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"it holds {name}")
