"""Conversion of a bag to a recording, with one view for each position at which the arm stood still."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cell.bag.bag_file import Bag, open_bag
from cell.bag.depth_image import depth_counts, depth_unit, is_rectified
from cell.bag.errors import BagError
from cell.bag.frames import Frames, find_frames, fixed_camera
from cell.bag.stationary import Place, Rest, find_rest
from cell.bag.survey import Survey, Topics, find_topics, survey
from cell.bag.tf_tree import nanoseconds
from cell.camera.frame_averaging import median
from cell.devices import InvalidViewError, View
from cell.recording.errors import shown
from cell.recording.header import Box
from cell.recording.limits import DEFAULT_LIMITS
from cell.recording.whole_recording import require_new, write_whole
from cell.recording.writer import RecordingHeader

LEAST_VIEWS = 2
"""Smallest number of views for recognition."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What the caller knows about a bag. None means that the value is found in the bag."""

    depth_topic: str | None = None
    info_topic: str | None = None
    base_frame: str | None = None
    flange_frame: str | None = None
    camera_frame: str | None = None
    depth_unit_m: float | None = None
    """Metres per count of 16UC1, and unit to which metres of 32FC1 are rounded."""
    rectified: bool = False
    """Whether the images are rectified although their topic's name does not say so."""
    T_flange_camera: NDArray[np.float64] | None = None
    """(4, 4) hand-eye calibration to be used instead of /tf."""
    hand_eye: str = "tf"
    """Source of `T_flange_camera`, for the provenance."""
    string_radius_m: float | None = None
    table_z_m: float = 0.0
    workspace_m: Box | None = None


@dataclass(frozen=True, eq=False)
class Imported:
    """Result of `import_bag`."""

    topics: Topics
    frames: Frames
    rest: Rest


def import_bag(path: Path, out: Path, wanted: Wanted) -> Imported:
    """Write the recording of a bag, completely or not at all.

    Args:
        path: The bag.
        out: The recording to write; it must not exist.
        wanted: What the caller knows about the bag.

    Raises:
        RecordingError: The bag cannot be used (BagError), `out` exists, or a value of `wanted` is impossible.
        NotRigidError: A pose is not rigid.
        InvalidViewError: A camera matrix is not valid.
        OSError: The recording cannot be written.
    """
    require_new(out)
    with open_bag(path) as bag:
        topics = find_topics(bag, wanted.depth_topic, wanted.info_topic)
        told = survey(bag, topics, wanted.rectified or is_rectified(topics.depth))
        camera = wanted.camera_frame or told.camera_frame
        frames = find_frames(told.tree, wanted.base_frame, wanted.flange_frame, camera)
        rest = find_rest(told.tree.chain(frames.base, frames.flange), told.stamps_ns)
        _check_count(rest, len(told.stamps_ns))
        T_flange_camera = wanted.T_flange_camera
        if T_flange_camera is None:
            taken_ns = told.stamps_ns[[frame for place in rest.places for frame in place.frames]]
            T_flange_camera = fixed_camera(told.tree, frames, taken_ns)
        header = RecordingHeader(
            depth_unit_m=depth_unit(told.encoding, wanted.depth_unit_m),
            string_radius_m=wanted.string_radius_m,
            T_flange_camera=T_flange_camera,
            table_z_m=wanted.table_z_m,
            workspace_m=wanted.workspace_m,
            provenance=_provenance(bag, topics, frames, rest, told.encoding, wanted.hand_eye),
        )
        write_whole(out, header, _views(bag, topics, told, rest, header))
    return Imported(topics, frames, rest)


def _check_count(rest: Rest, images: int) -> None:
    """Raise BagError for too few or too many views."""
    if LEAST_VIEWS <= len(rest.places) <= DEFAULT_LIMITS.views:
        return
    of = f"of {images} depth images {rest.moving} were taken in motion, of {rest.unknown} the pose is not known"
    if len(rest.places) < LEAST_VIEWS:
        raise BagError(
            f"the arm stands still at {len(rest.places)} places ({of}); {LEAST_VIEWS} at least are needed, eight are "
            "good, half a second and more at each"
        )
    raise BagError(
        f"the arm stands still at {len(rest.places)} places ({of}); {DEFAULT_LIMITS.views} at most are taken: cut the "
        "bag"
    )


def _provenance(
    bag: Bag, topics: Topics, frames: Frames, rest: Rest, encoding: str, hand_eye: str
) -> Mapping[str, str]:
    return {
        "source": f"ROS {bag.ros} bag",
        "bag": shown(bag.name),
        "depth_topic": shown(topics.depth),
        "depth_encoding": shown(encoding),
        "info_topic": shown(topics.info),
        "base_frame": shown(frames.base),
        "flange_frame": shown(frames.flange),
        "camera_frame": shown(frames.camera),
        "hand_eye": shown(hand_eye),
        "frames_per_view": " ".join(str(len(place.frames)) for place in rest.places),
    }


def _views(bag: Bag, topics: Topics, told: Survey, rest: Rest, header: RecordingHeader) -> Iterator[View]:
    """Yield the views one after the other. If the bag is in order, only the images of one view are in memory."""
    place_of = {int(told.stamps_ns[frame]): k for k, place in enumerate(rest.places) for frame in place.frames}
    held: dict[int, list[NDArray[np.uint16]]] = {}
    for _, image in bag.messages([topics.depth]):
        stamp_ns = nanoseconds(image.header.stamp)
        k = place_of.pop(stamp_ns, None)  # a duplicate is used once
        if k is None:
            continue
        depth = depth_counts(image, header.depth_unit_m, f"{shown(topics.depth)}, image of {stamp_ns} ns")
        held.setdefault(k, []).append(depth)
        if len(held[k]) == len(rest.places[k].frames):
            yield _view(k, rest.places[k], median(held.pop(k)), told, header)


def _view(index: int, place: Place, depth: NDArray[np.uint16], told: Survey, header: RecordingHeader) -> View:
    try:
        return View(
            index=index,
            depth=depth,
            depth_unit_m=header.depth_unit_m,
            K=told.lens.K,
            T_base_flange=place.T_base_flange,
            T_flange_camera=header.T_flange_camera,
            stamp_s=place.stamp_ns / 1e9,
        )
    except InvalidViewError as error:
        raise BagError(str(error)) from error
