"""Single views of a recording, which may still be written, for display during a scan."""

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
    """Pose and camera matrix of a view."""

    index: int
    """Index of the view."""
    T_base_camera: NDArray[np.float64]
    """(4, 4) camera pose."""
    K: NDArray[np.float64]
    """(3, 3) pinhole matrix, pixels."""
    width: int
    """Width of the image, pixels."""
    height: int
    """Height of the image, pixels."""


def read_view(path: Path, index: int, limits: Limits = DEFAULT_LIMITS) -> tuple[View, RecordingHeader] | None:
    """Read one view with the header of the recording. The file is read only until the view is complete.

    Args:
        path: The MCAP file.
        index: Index of the view.
        limits: Sizes up to which the file is read.

    Returns:
        View and header, or None if the view is not in the file, or not yet.

    Raises:
        RecordingError: The recording cannot be used. The subclass and the message say why and where.
    """

    def of_view(message: TopicMessage) -> bool:
        return message.sequence == index

    def is_whole(contents: Contents) -> bool:
        parts = contents.views.get(index)
        if parts is None or contents.metadata is None or contents.hand_eye is None:  # other writers may write them last
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
    """Read pose and camera matrix of each complete view, without the images.

    Args:
        path: The MCAP file.
        limits: Sizes up to which the file is read.

    Returns:
        Poses in the order of the indices.

    Raises:
        RecordingError: As for `read_view`.
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
