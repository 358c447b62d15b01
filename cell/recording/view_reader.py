"""Single views of a recording that may still be written: what a person wants to look at while the arm moves."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.devices import View
from cell.recording.contents import Contents, collect
from cell.recording.header import RecordingHeader
from cell.recording.limits import DEFAULT_LIMITS, Limits
from cell.recording.mcap_stream import TopicMessage
from cell.recording.messages import CALIBRATION, DEPTH, POSE
from cell.recording.reader import header_of, view_of


@dataclass(frozen=True, eq=False)
class ViewPose:
    """From where a view was taken, and through which lens."""

    index: int
    T_base_camera: NDArray[np.float64]
    """(4, 4)."""
    K: NDArray[np.float64]
    """(3, 3), pixels."""
    width: int
    height: int


def read_view(path: Path, index: int, limits: Limits = DEFAULT_LIMITS) -> tuple[View, RecordingHeader] | None:
    """One view with the recording's header, read up to where it is whole; None: it is not, or not yet, in the file.

    Raises:
        RecordingError: the recording cannot be used; the subclass and the message say why and where.
    """

    def of_view(message: TopicMessage) -> bool:
        return message.sequence == index

    def is_whole(contents: Contents) -> bool:
        parts = contents.views.get(index)
        if parts is None or contents.metadata is None or contents.hand_eye is None:  # others may write them last
            return False
        return all(part is not None for part in (parts.pose, parts.calibration, parts.depth))

    contents = collect(path, limits, of_view, is_whole)
    parts = contents.views.get(index)
    if parts is None:
        return None
    header = header_of(contents, path.name)
    view = view_of(index, parts, header)
    return None if view is None else (view, header)


def read_poses(path: Path, limits: Limits = DEFAULT_LIMITS) -> list[ViewPose]:
    """From where each view was taken, by their indices; without their images.

    Raises:
        RecordingError: as for `read_view`.
    """
    whole: set[int] = set()

    def is_small(message: TopicMessage) -> bool:
        if message.topic == DEPTH:
            whole.add(message.sequence)
        return message.topic in (POSE, CALIBRATION)

    contents = collect(path, limits, is_small)
    if not contents.views:
        return []
    T_flange_camera = header_of(contents, path.name).T_flange_camera
    return [
        ViewPose(index, parts.pose @ T_flange_camera, lens.K, lens.width, lens.height)
        for index, parts in sorted(contents.views.items())
        if index in whole and parts.pose is not None and (lens := parts.calibration) is not None
    ]
